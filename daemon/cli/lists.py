"""Commands that take two lists of files with `--` between them."""

from __future__ import annotations

from typing import Any

from typer.core import TyperCommand

AFTER = "after the dashes"


class TwoLists(TyperCommand):
    """A command whose files after `--` are counted, and whose options may stand behind them as everywhere else.

    The parser alone would drop the dashes and take all that follows for files.
    """

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """As every command, with the number of files after `--` under AFTER in `ctx.meta`, None without dashes."""
        ctx.meta[AFTER] = None
        if "--" in args:
            place = args.index("--")
            args, behind = [*args[:place], *args[place + 1 :]], args[place + 1 :]
            values, _, _ = self.make_parser(ctx).parse_args(list(behind))
            ctx.meta[AFTER] = max((len(value) for value in values.values() if isinstance(value, tuple)), default=0)
        return super().parse_args(ctx, args)
