"""Power failures under `label`: the file system is shut down at random moments, and the same command runs again.

Run as root, ``python benchmarks/power_loss.py FOLDER [--tries N] [--seed N]``. An ext4 file system in a file is mounted
by a loop device below FOLDER. A street is labelled into it; at a random moment the ``EXT4_IOC_SHUTDOWN`` ioctl drops
everything that is not on the device, the journal of the file system included. The file system is mounted again, and the
same command must end with the bytes of an undisturbed run. Ends with status 1 if anything differs.
"""

import argparse
import fcntl
import json
import os
import random
import shutil
import struct
import subprocess
import sys
import threading
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from helpers.faults.trials import Trials, results

SHUTDOWN, WITHOUT_JOURNAL = 0x8004587D, 2
"""EXT4_IOC_SHUTDOWN, and its flag that drops the journal too."""
SIZE = 512 << 20


def mount(image: Path, place: Path) -> None:
    """Mount the file system."""
    subprocess.run(["mount", "-o", "loop", str(image), str(place)], check=True)


def unmount(place: Path) -> None:
    """Unmount it; the kernel may hold it for a moment after a shutdown."""
    for _ in range(50):
        if subprocess.run(["umount", str(place)], check=False, capture_output=True).returncode == 0:
            return
        time.sleep(0.1)
    sys.exit(f"{place} cannot be unmounted")


def shut_down(place: Path, device: int) -> None:
    """Drop everything of the mounted image that is not on its device; no other file system is touched."""
    folder = os.open(place, os.O_RDONLY)
    try:
        if os.fstat(folder).st_dev != device:
            return
        fcntl.ioctl(folder, SHUTDOWN, struct.pack("I", WITHOUT_JOURNAL))
    finally:
        os.close(folder)


def different(expected: dict[str, str], found: dict[str, str]) -> list[str]:
    """Return the names of results that differ or are missing on either side."""
    return sorted(name for name in expected.keys() | found.keys() if expected.get(name) != found.get(name))


def main() -> int:
    """Compare disturbed and undisturbed runs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--tries", type=int, default=32)
    parser.add_argument("--seed", type=int, default=2019)
    options = parser.parse_args()
    chance, image = random.Random(options.seed), options.folder / "image"
    with Trials(options.folder, "label") as trials:
        image.write_bytes(b"")
        os.truncate(image, SIZE)
        subprocess.run(["mkfs.ext4", "-q", str(image)], check=True)
        beside = trials.root.stat().st_dev
        mount(image, trials.root)
        device = trials.root.stat().st_dev
        assert device != beside, f"{image} is not mounted"
        timer = threading.Timer(0.0, shut_down)
        try:
            trials.run("warm")
            began = time.monotonic()
            assert trials.run("whole")[0] == 0, trials.said
            seconds = time.monotonic() - began
            expected, failed, lost = results(trials.root / "whole"), 0, 0
            for number in range(options.tries):
                output = trials.root / f"o{number}"
                moment = chance.uniform(0.05, 1.0) * seconds
                timer = threading.Timer(moment, shut_down, [trials.root, trials.root.stat().st_dev])
                timer.start()
                first = trials.run(output.name)[0]
                timer.join()
                unmount(trials.root)
                mount(image, trials.root)
                lost += first != 0
                status = trials.run(output.name)[0]
                wrong = different(expected, results(output) if output.exists() else {})
                if status or wrong:
                    failed += 1
                    print(json.dumps({"moment": moment, "said": trials.said, "wrong": wrong}), flush=True)
                shutil.rmtree(output, ignore_errors=True)
        finally:
            timer.cancel()
            if timer.ident is not None:
                timer.join()
            unmount(trials.root)
    row = {"stage": "power_loss", "seconds": round(seconds, 1), "tries": options.tries, "interrupted": lost}
    print(json.dumps({**row, "failures": failed}))
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
