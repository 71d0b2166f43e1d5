"""Fuzz the readers of files, the requests of the page or the import of corrections with Atheris, guided by coverage.

    pip install atheris
    python scripts/fuzz.py readers|requests|imports [--seconds 3600] [--found FOLDER] [--keep N]

Mutates the small sound inputs of the tests (`tests/helpers/mutations.py`, and libFuzzer's own mutations). An input that
reaches new branches of the package is kept and mutated further. A failure is an error that is not of `MlsRoadError`, a
call of more than 20 s of processor time, a cloud with another number of points than its header says, with coordinates
that are not finite or that differ from those of laspy, or an accepted request after which the page or the delivery
fails. Each kind of failure is written into the folder, and counts into `counts.json`. `--keep` does not fuzz: it
replaces the inputs of `tests/fuzz_corpus.tar.xz` by N of those that the folder holds.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import resource
import signal
import sys
import tempfile
import traceback
import warnings
from collections import Counter
from pathlib import Path

import atheris  # type: ignore[import-not-found]  # not among the locked packages
import numpy as np

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = str(ROOT / "src/mlsroad_pipeline")
_COMPILED = [
    ".".join(path.relative_to(ROOT / "src").with_suffix("").parts)
    for path in Path(PACKAGE).rglob("*.py")
    if "numba" in path.read_text(encoding="utf-8")  # Numba cannot compile instrumented functions
]
atheris.instrument_imports(include=["mlsroad_pipeline"], exclude=_COMPILED).__enter__()  # also of later imports
sys.path.insert(0, str(ROOT / "tests"))

from helpers.fuzz_targets import Target, corpus, keep, targets  # noqa: E402  # of the tests, after the instrumentation
from helpers.mutations import mutated  # noqa: E402

from mlsroad_pipeline.algorithms.core.exceptions import MlsRoadError  # noqa: E402

LONGEST, MEMORY = 20, 6 << 30
FRESH = 0.2
"""Share of inputs that are mutated from a sound one: libFuzzer drops those of a target whose branches others reach."""


class HangError(BaseException):
    """A call takes too long."""


def _alarm(*_: object) -> None:
    raise HangError(f"more than {LONGEST} s")


class Fuzzer:
    """Targets of a group; the first byte of an input is the number of its target."""

    def __init__(self, every: list[Target], place: Path, found: Path) -> None:
        self.every, self.place, self.found = every, place, found
        self.runs, self.refused, self.kinds = Counter[str](), Counter[str](), dict[str, str]()

    def mutate(self, data: bytes, largest: int, seed: int) -> bytes:
        """Return a mutated input of the same target: by its kind of content in most cases, else by libFuzzer."""
        rng = np.random.default_rng(seed)
        if not data or rng.random() < FRESH:
            number = int(rng.integers(len(self.every)))
            seeds = self.every[number].seeds
            data = bytes([number]) + seeds[int(rng.integers(len(seeds)))]
        number = data[0] % len(self.every)
        base, own = data[1:], self.every[number]
        if rng.random() < 0.25 or not base:
            changed = atheris.Mutate(base, largest - 1)
        else:
            try:
                changed = own.mutate(base, rng)
            except (ValueError, IndexError, TypeError, AttributeError):  # not text, JSON or a table any more
                changed = mutated(base, rng)
        return bytes([number]) + bytes(changed)[: largest - 1]

    def name(self, data: bytes) -> str:
        """Return the name of the target of an input."""
        return self.every[data[0] % len(self.every)].path.relative_to(self.place).as_posix()

    def run(self, data: bytes) -> None:
        """Read an input; note how the reader failed."""
        if not data:
            return
        target, name = self.every[data[0] % len(self.every)], self.name(data)
        signal.setitimer(signal.ITIMER_PROF, LONGEST)  # of processor time: a stopped process does not hang
        try:
            try:
                target.read(data[1:])
            except MlsRoadError:  # damaged input is refused by such an error
                self.refused[name] += 1
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # also panics of Rust
            frames = [f for f in traceback.extract_tb(error.__traceback__) if f.filename.startswith(PACKAGE)]
            where = f"{frames[-1].filename} line {frames[-1].lineno}" if frames else f"check: {error!s:.60}"
            self._note(f"{name}: {type(error).__name__} in {where}", f"{error!s:.300}", data[1:], target)
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)
        self.runs[name] += 1
        if sum(self.runs.values()) % 50 == 0:
            counts = {"runs": self.runs, "refused": self.refused, "kinds": self.kinds, "seconds": sum(os.times()[:2])}
            (self.found / "counts.json").write_text(json.dumps(counts, indent=1))

    def _note(self, kind: str, message: str, content: bytes, target: Target) -> None:
        if kind not in self.kinds:
            self.kinds[kind] = message
            (self.found / f"{len(self.kinds)}_{target.path.name}").write_bytes(content)
            sys.stderr.write(f"FOUND {len(self.kinds)}_{target.path.name}: {kind}: {message}\n")


def main() -> None:
    """Fuzz the targets of a group together."""
    warnings.simplefilter("ignore")
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("group", choices=["readers", "requests", "imports"])
    arguments.add_argument("--seconds", type=int, default=3600)
    arguments.add_argument("--found", type=Path, default=Path("fuzz_found"))
    arguments.add_argument("--keep", type=int, default=0)
    options = arguments.parse_args()
    reached = options.found / "corpus"
    reached.mkdir(parents=True, exist_ok=True)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    signal.signal(signal.SIGPROF, _alarm)
    with tempfile.TemporaryDirectory() as folder:
        fuzzer = Fuzzer(targets(options.group, Path(folder)), Path(folder), options.found)
        if options.keep:
            seeds = {bytes([k]) + seed for k, target in enumerate(fuzzer.every) for seed in target.seeds}
            found = sorted({path.read_bytes() for path in reached.iterdir()} - seeds)
            chosen = [found[i] for i in np.linspace(0, len(found) - 1, options.keep, dtype=int)]
            keep(options.group, [(fuzzer.name(content), content[1:]) for content in chosen if content])
            return
        for number, target in enumerate(fuzzer.every):
            for seed in target.seeds:
                target.read(seed)  # the sound input is not refused
            for seed in (*target.seeds, *corpus(options.group, fuzzer.name(bytes([number])))):
                content = bytes([number]) + seed
                (reached / hashlib.sha256(content).hexdigest()).write_bytes(content)
        words = [f"-max_total_time={options.seconds}", "-timeout=1200", f"-artifact_prefix={options.found}/"]
        words += ["-max_len=2000000", "-len_control=0", "-rss_limit_mb=0", "-print_final_stats=1", "-reload=0"]
        atheris.Setup([sys.argv[0], str(reached), *words], fuzzer.run, custom_mutator=fuzzer.mutate)
        atheris.Fuzz()


if __name__ == "__main__":
    main()
