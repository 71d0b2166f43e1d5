"""Start of the command: `mlsroad label` of a tile, and commands that label nothing, from start to end.

    python benchmarks/bench_start.py [--repeats 5] [--tile FILE.laz] [--source FOLDER]

The tile is a simulated street of a million points, made once, unless one is given. With `--source`, the folder `src` of
another version is measured alternately. Processor time is that of all processes, sampled every 20 ms.
"""

import json
import os
import shutil
import sys
import tempfile
from functools import partial
from pathlib import Path

from _common import REPOSITORY, Timed, parser, race, watched
from bench_label import FOLDER, make_survey

COMMANDS = (("--help",), ("inspect", "--help"), ("models",))


def run(words: list[str], source: Path, folder: Path) -> Timed:
    """Run a command with the sources of a version."""
    shutil.rmtree(folder / "labelled", ignore_errors=True)
    command = [str(Path(sys.executable).with_name("mlsroad")), *words]
    environment = {**os.environ, "PYTHONPATH": str(source)}
    seconds, tree = watched(command, folder / "log.txt", interval=0.02, memory=False, env=environment)
    return Timed(seconds, tree.cpu)


def main() -> None:
    """Run the commands alternately and print medians."""
    arguments = parser(__doc__)
    arguments.add_argument("--repeats", type=int, default=5)
    arguments.add_argument("--tile", type=Path)
    arguments.add_argument("--source", type=Path)
    options = arguments.parse_args()
    tile = options.tile or make_survey(FOLDER, 1)
    versions = {"mlsroad": REPOSITORY / "src"} | ({"other version": options.source} if options.source else {})
    commands = {" ".join(words): list(words) for words in COMMANDS}
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        commands = {"label": ["label", str(tile.resolve()), "-o", str(folder / "labelled")], **commands}
        works = {
            (name, version): partial(run, words, source, folder)
            for name, words in commands.items()
            for version, source in versions.items()
        }
        for (name, version), timed in race(works, repeats=options.repeats).items():
            row = {"kernel": f"mlsroad {name}, processor time", "program": version, "seconds": round(timed.cpu, 3)}
            print(json.dumps(row | {"elapsed": round(timed.seconds, 3)}), flush=True)


if __name__ == "__main__":
    main()
