"""Inputs guided by coverage: `python -m fuzz.guided TARGET --runs 100000`; needs atheris.

libFuzzer keeps the inputs that reach new branches of the Python code of the readers and changes
them further, by its own changes or by those of the target. The HDF5 library is no Python and is
in another process, so it is not covered.
"""

from __future__ import annotations

import argparse
import random
import sys
import tempfile
import warnings
from pathlib import Path


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m fuzz.guided", description=__doc__)
    parser.add_argument("target", metavar="TARGET")
    parser.add_argument("--runs", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", type=Path, default=Path("fuzz-faults"), help="inputs at fault")
    options = parser.parse_args()
    try:
        import atheris
    except ImportError:
        parser.error("atheris is not installed: pip install '.[fuzz]' (Linux on x86-64 only)")
    with atheris.instrument_imports(include=["measurement_io", "clradar"]):
        import measurement_io  # noqa: F401 - before all others that import it

    from fuzz.oracle import Watch, judge
    from fuzz.worker import find_target, read_seeds

    target = find_target(options.target)
    folder = Path(tempfile.mkdtemp(prefix="clradar-fuzz-"))
    corpus, files = folder / "corpus", folder / "files"
    corpus.mkdir()
    files.mkdir()
    options.keep.mkdir(parents=True, exist_ok=True)
    warnings.simplefilter("ignore")
    path = target.place(files)
    read_seeds(target, path)
    for number, content in enumerate(target.seeds()):
        (corpus / str(number)).write_bytes(content)
    tokens = folder / "tokens"
    escaped = ["".join(f"\\x{byte:02x}" for byte in token) for token in target.dictionary]
    tokens.write_text("".join(f'"{text}"\n' for text in escaped if len(text) < 400))
    watch = Watch(files)

    def try_one(content: bytes) -> None:
        path.write_bytes(content)
        outcome, fault = judge(target, path, watch)
        if outcome == "fault":
            raise AssertionError(f"{target.name}: {fault}")

    def mutate(content: bytes, max_size: int, seed: int) -> bytes:
        rng = random.Random(seed)
        if rng.random() < 0.5:
            return bytes(atheris.Mutate(content, max_size))
        return target.mutate(bytes(content), rng)[:max_size]

    arguments = [
        sys.argv[0],
        f"-runs={options.runs}",
        f"-seed={options.seed}",
        f"-timeout={int(6 * target.processor_limit_s)}",
        f"-dict={tokens}",
        f"-artifact_prefix={options.keep}/{target.name}-",
        "-max_len=200000",
        "-rss_limit_mb=3000",
        "-print_final_stats=1",
        str(corpus),
    ]
    atheris.Setup(arguments, try_one, custom_mutator=mutate)
    atheris.Fuzz()
    return 0


if __name__ == "__main__":
    sys.exit(main())
