"""Run the readers on mutated files: `python -m fuzz --help`; CONTRIBUTING.md has the path."""

import argparse
import sys
from pathlib import Path

from fuzz import harness
from fuzz.targets import TARGETS


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m fuzz", description=__doc__)
    parser.add_argument("targets", nargs="*", metavar="TARGET", help=", ".join(TARGETS))
    parser.add_argument("--runs", type=int, default=100_000, help="inputs per target (%(default)s)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--start", type=int, default=0, help="number of the first input")
    parser.add_argument("--keep", type=Path, default=Path("fuzz-faults"), help="inputs at fault")
    parser.add_argument("--read", type=Path, help="read this one file as TARGET would")
    options = parser.parse_args()
    if unknown := [name for name in options.targets if name not in TARGETS]:
        parser.error(f"no target {', '.join(unknown)}; there are {', '.join(TARGETS)}")
    if options.read is not None:
        print(*harness.judge(TARGETS[options.targets[0]], options.read))
        return 0
    failed = False
    for name in options.targets or TARGETS:
        outcome = harness.run(
            TARGETS[name], options.runs, seed=options.seed, start=options.start, keep=options.keep
        )
        print(f"{name}: {outcome}", flush=True)
        failed |= bool(outcome.faults)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
