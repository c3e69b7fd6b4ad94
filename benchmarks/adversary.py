"""Sequences of bad wires, lying robots, stalls and refused sends against the real loop, judged at the robot's side.

Reproduce: `python -m benchmarks.adversary --sequences 10000 --seed 1`. Each sequence is drawn from its own seed and
played in simulated time (tests/fri_client/adversary). Printed per kind of move: how many sequences played it and the
worst velocity, acceleration and jerk of any of them, in percent of the limit, between commands that went out, in
the robot's own cycles; then every violation with the seed that plays it again (`--only SEED`).
"""

from __future__ import annotations

import argparse
import multiprocessing
import time
from collections import Counter

import numpy as np

from tests.fri_client.adversary.sequences import drawn
from tests.fri_client.adversary.world import play

_QUANTITIES = ("velocity", "acceleration", "jerk")


def _one(seed: int) -> tuple[int, tuple[str, ...], list[float], int, str, str]:
    setting, moves = drawn(seed)
    outcome = play(setting, moves)
    found = outcome.judgement
    worst = [max(found.percents(name)) for name in _QUANTITIES]
    first = found.excesses[0].sentence() if found.excesses else ""
    ended = "time over" if outcome.result is None else outcome.result.outcome
    return seed, tuple(sorted({move.kind for move in moves})), worst, found.excess_count, first, ended


def main() -> None:
    """Parse, play, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sequences", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1, help="of the first sequence; the others follow")
    parser.add_argument("--only", type=int, help="play this seed alone and print its moves")
    parser.add_argument("--jobs", type=int, default=multiprocessing.cpu_count())
    arguments = parser.parse_args()
    if arguments.only is not None:
        print(*drawn(arguments.only), sep="\n")
        print(_one(arguments.only))
        return
    begun = time.monotonic()
    first = arguments.seed * 1_000_000
    worst: dict[str, np.ndarray] = {}
    played: Counter[str] = Counter()
    endings: Counter[str] = Counter()
    violations, faults = [], []
    with multiprocessing.Pool(arguments.jobs) as pool:
        seeds = range(first, first + arguments.sequences)
        for seed, kinds, shares, count, sentence, ended in pool.imap_unordered(_one, seeds, chunksize=8):
            endings[ended] += 1
            if ended == "fault":
                faults.append(f"seed {seed}: an internal error")
            for kind in (*kinds, "any"):
                played[kind] += 1
                worst[kind] = np.maximum(worst.get(kind, np.zeros(3)), shares)
            if count:
                violations.append(f"seed {seed}: {count} times; {sentence}")
    print(f"{arguments.sequences} sequences from seed {first}, {time.monotonic() - begun:.0f} s; ends: {dict(endings)}")
    print(f"{'move':<18}{'played':>8}{'v %':>9}{'a %':>9}{'j %':>9}")
    for kind in sorted(worst):
        print(f"{kind:<18}{played[kind]:>8}" + "".join(f"{share:9.2f}" for share in worst[kind]))
    print(f"{len(violations)} sequences with a command beyond the limits")
    print("\n".join([*violations, *faults]))


if __name__ == "__main__":
    main()
