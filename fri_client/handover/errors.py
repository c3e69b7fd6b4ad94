"""What can be wrong with the ring between loop and recorder; the tree is drawn in `fri_client.errors`."""

from __future__ import annotations

import errno

from fri_client.errors import FriError


class HandoverError(FriError):
    """The ring cannot be created or attached: wrong descriptor, wrong layout, no memory, unsuited processor."""

    exit_code = 70


class NoMemoryForHandover(HandoverError):
    """The operating system refuses the ring its memory; `size`: bytes, `errno`: why."""

    exit_code = 74

    def __init__(self, *, size: int, error: OSError) -> None:
        limited = "; the shell limits the size of files (ulimit -f)" if error.errno == errno.EFBIG else ""
        super().__init__(f"No {size} bytes of memory can be had for the samples: {error.strerror}{limited}.")
        self.size = size
        self.errno = error.errno
