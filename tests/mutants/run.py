"""Single faults in the code (`mutants.toml`), and which test notices each.

python tests/mutants/run.py                  all; status 1 if one survives that may not
python tests/mutants/run.py tracing lobe     of these folders or files, or with ids that begin so

Faults are put into copies of the working tree, which itself stays as it is.
"""

import argparse
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from queue import SimpleQueue
from typing import Any

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

LIMIT_S = 300
"""For the tests of one fault: one that makes a loop endless is noticed."""

Mutant = dict[str, Any]


def table_of(root: Path) -> list[Mutant]:
    """The table of single faults."""
    found = tomllib.loads((root / "tests/mutants/mutants.toml").read_text("utf-8"))
    return list(found["mutant"])


def is_chosen(mutant: Mutant, only: list[str]) -> bool:
    return not only or any(
        mutant["id"].startswith(word) or f"/{word.strip('/')}/" in f"/{mutant['file']}/"
        for word in only
    )


def copy_tree(root: Path, to: Path) -> None:
    """Copy the files that git tracks, or would."""
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(command, cwd=root, capture_output=True, text=True, check=True).stdout
    for name in filter(None, listed.split("\0")):
        if (root / name).is_file():  # one that was deleted is listed, too
            (to / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(root / name, to / name)


class Runner:
    """Runs tests on copies of a tree, one for every job."""

    def __init__(self, root: Path, folder: Path, jobs: int) -> None:
        self.copies: SimpleQueue[Path] = SimpleQueue()
        self.running: set[int] = set()
        for job in range(jobs):
            copy_tree(root, folder / str(job))
            self.copies.put(folder / str(job))

    def try_mutant(self, mutant: Mutant) -> tuple[Mutant, str, str, float]:
        """The mutant, "killed", "survived" or "faulty", by what, and seconds."""
        start, copy = time.monotonic(), self.copies.get()
        path = copy / mutant["file"]
        whole = path.read_bytes() if path.is_file() else b""
        try:
            text = whole.decode("utf-8")
            if (n := text.count(mutant["text"])) != 1:
                return mutant, "faulty", f"its text is in {mutant['file']} {n} times", 0.0
            self._put(path, text.replace(mutant["text"], mutant["becomes"]).encode("utf-8"))
            state, why = self.test(copy, mutant["tests"])
            return mutant, state, why, time.monotonic() - start
        finally:
            if whole:
                self._put(path, whole)
            self.copies.put(copy)

    def _put(self, path: Path, content: bytes) -> None:
        path.write_bytes(content)
        # Compiled files are told by size and second, in which a fault may be as large as the truth.
        for compiled in path.parent.glob(f"__pycache__/{path.stem}.*"):
            compiled.unlink()

    def test(self, copy: Path, tests: list[str], *options: str) -> tuple[str, str]:
        environment = {**os.environ, "PYTHONPATH": str(copy), "OPENBLAS_NUM_THREADS": "1"}
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider"]
        process = subprocess.Popen(
            [*command, *options, *tests], cwd=copy, env=environment, text=True,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True,
        )  # fmt: skip
        self.running.add(process.pid)
        try:
            output = process.communicate(timeout=None if options else LIMIT_S)[0]
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
            return "killed", "time"
        finally:
            self.running.discard(process.pid)
        if process.returncode < 0:
            return "killed", "crash"
        failed = re.search(r"^(?:FAILED|ERROR) (.*?)(?: - |$)", output, re.MULTILINE)
        if process.returncode == 0:
            return "survived", ""
        if process.returncode != 1 or not failed or " does not build" in output:
            return "faulty", f"its tests cannot run:\n{output[-2000:]}"
        return "killed", failed[1]

    def stop(self) -> None:
        for pid in list(self.running):
            os.killpg(pid, signal.SIGKILL)


def main(root: Path, arguments: list[str]) -> int:
    """Try the chosen mutants; the exit status."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("only", nargs="*", help="folders, files, or beginnings of ids")
    parser.add_argument("--jobs", type=int, default=2, help="how many at a time")
    options = parser.parse_args(arguments)
    chosen = [mutant for mutant in table_of(root) if is_chosen(mutant, options.only)]
    if not chosen:
        print(f"No mutant of {', '.join(options.only)}.")
        return 2
    counts, wrong = {"killed": 0, "survived": 0, "faulty": 0}, list[str]()
    with (
        tempfile.TemporaryDirectory(prefix="mutants-") as folder,
        ThreadPoolExecutor(options.jobs) as pool,
    ):
        runner = Runner(root, Path(folder), options.jobs)
        try:
            # A test that fails anyway notices nothing.
            tests = sorted({test for mutant in chosen for test in mutant["tests"]})
            spread = ("-n", str(options.jobs), "--dist", "loadfile")
            state, why = runner.test(Path(folder) / "0", tests, *spread)
            if state != "survived":
                print(f"Without any fault: {why}")
                return 2
            for mutant, state, why, seconds in pool.map(runner.try_mutant, chosen):
                counts[state] += 1
                reason = mutant.get("survived", "") if state == "survived" else why
                print(f"{mutant['id']:32} {state:8} {seconds:6.1f} s  {reason}", flush=True)
                if state == "faulty" or (state == "survived" and not reason):
                    wrong.append(mutant["id"])
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            runner.stop()
            raise
    print(", ".join(f"{n} {state}" for state, n in counts.items()))
    if wrong:
        print(f"Not as they should be: {', '.join(wrong)}; a survivor needs a reason in the table.")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main(Path(__file__).resolve().parents[2], sys.argv[1:]))
