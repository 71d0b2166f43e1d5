"""Time and memory of a vocabulary of the paper's size: 120,000 words of 40 simulated samples of 50 m (yu2016, V-D).

The paper states 39 minutes on 16 threads. Streets are alternately ring roads and campuses, scanned by a VMX-450 at its
full rate. Described samples are stored in a folder: their simulation is not timed, and a second run resumes an
interrupted one. As in training, the nearest word of every group is searched once more for the stop list.

    python benchmarks/vocabulary_cost.py FOLDER [--words 120000] [--samples 40] [--threads 2]
"""

from __future__ import annotations

import argparse
import json
import resource
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.segmentation.stage import SegmentationParameters, segment_scene
from mlsroad_pipeline.papers.shared.detection.regions import RegionParameters
from mlsroad_pipeline.papers.yu2016.study.streets import make_survey
from mlsroad_pipeline.papers.yu2016.visual_words.descriptions import GroupParameters, describe_objects, groups_of
from mlsroad_pipeline.papers.yu2016.visual_words.groups import join_groups
from mlsroad_pipeline.papers.yu2016.visual_words.vocabulary import VocabularyParameters, build_vocabulary
from mlsroad_pipeline.simulation.parameters.presets import PRESETS
from mlsroad_pipeline.simulation.parameters.street_parameters import STREETS

LENGTH = 50.0
KINDS = ("ring_road", "campus")
COLUMNS = ("descriptors", "orientations", "scales", "objects")


def sample(number: int, folder: Path, parameters: GroupParameters) -> dict[str, np.ndarray]:
    """Return the groups of a sample, from the folder or by simulation."""
    file = folder / f"sample_{number:02d}_{parameters.regions.seed_resolution:g}.npz"
    if not file.exists():
        survey = replace(
            PRESETS["vmx450"], seed=number, length=LENGTH, with_images=False, street=STREETS[KINDS[number % len(KINDS)]]
        )
        street = make_survey(simulation=survey, ground=GroundParameters())["points"]
        objects = segment_scene(street, {"ground": street["ground"]}, SegmentationParameters())
        found = describe_objects(street, objects, parameters=parameters)
        np.savez(file, **{name: found[name] for name in COLUMNS})
    with np.load(file) as stored:
        return {name: stored[name] for name in COLUMNS}


def main() -> None:
    """Describe the samples, build the vocabulary, print a line and a line of JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="folder of described samples")
    parser.add_argument("--samples", type=int, default=40)
    parser.add_argument("--words", type=int, default=120_000)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--seed-resolution", type=float, default=0.2, help="of the supervoxels, metres (yu2016: 0.1)")
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    regions = RegionParameters(voxel_size=given.seed_resolution / 2, seed_resolution=given.seed_resolution)
    described = [sample(k, given.folder, GroupParameters(regions)) for k in range(given.samples)]
    scenes = np.repeat(np.arange(len(described)), [len(found["objects"]) for found in described])
    groups = join_groups([groups_of(found) for found in described])
    del described
    wall, processor = time.perf_counter(), time.process_time()
    vocabulary, _ = build_vocabulary(
        groups, scenes, parameters=VocabularyParameters(n_words=given.words), n_threads=given.threads
    )
    figures = {
        "samples": given.samples,
        "groups": len(groups),
        "words": len(vocabulary),
        "threads": given.threads,
        "minutes": round((time.perf_counter() - wall) / 60, 2),
        "processor_minutes": round((time.process_time() - processor) / 60, 2),
        "peak_gib": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20, 2),
    }
    print("{words:,} words of {groups:,} groups: {minutes} minutes, {peak_gib} GiB".format(**figures))
    print(json.dumps(figures))


if __name__ == "__main__":
    main()
