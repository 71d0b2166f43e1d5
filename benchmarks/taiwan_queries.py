"""Street objects cut from a survey in Taiwan as queries of each other: how alike their bags of visual words are.

    python benchmarks/taiwan_queries.py FOLDER [--groups-per-word 50 10]

Every object is looked for with all others: the kind of the most alike one, and the average precision of its ranking
(the share of its own kind among the objects up to each of them). Kinds are the beginnings of the files' names. Words
are made of all objects, which know no kinds. Chance is the mean average precision of random rankings.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from sydney_recognition import CONF, configured
from yaml import safe_load

from mlsroad_pipeline.algorithms.core.point_cloud import concatenate
from mlsroad_pipeline.formats.options import ReadOptions
from mlsroad_pipeline.formats.registry import get_format
from mlsroad_pipeline.papers.yu2016.visual_words.bags import (
    count_words,
    inverse_document_frequency,
    similarity,
    weigh_words,
)
from mlsroad_pipeline.papers.yu2016.visual_words.descriptions import describe_objects, groups_of
from mlsroad_pipeline.papers.yu2016.visual_words.training import VisualWordsParameters
from mlsroad_pipeline.papers.yu2016.visual_words.vocabulary import VocabularyParameters, build_vocabulary

SHUFFLES = 200


def average_precision(alike: NDArray[np.float64], same: NDArray[np.bool_]) -> float:
    """Return the mean of the precisions at the places of the objects of the same kind."""
    right = same[np.argsort(-alike, kind="stable")]
    return float((np.cumsum(right)[right] / (np.flatnonzero(right) + 1)).mean())


def main() -> None:
    """Describe the objects, and compare all with all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--groups-per-word", nargs="+", type=float, default=[50.0, 10.0])
    given = parser.parse_args()
    environment = safe_load((CONF.parent / "taiwan_poles/parameters.yml").read_text(encoding="utf-8"))
    options = ReadOptions(**environment["survey"]["read"])
    files = sorted(given.folder.glob("*_*.csv.gz"))
    kinds = np.array([file.name.partition("_")[0] for file in files])
    clouds = [get_format(file).read(file, options) for file in files]
    objects = np.repeat(np.arange(len(files), dtype=np.int32), [len(cloud) for cloud in clouds])
    scene = concatenate(clouds)
    parameters = VisualWordsParameters(**configured("visual_words"))
    described = describe_objects(scene, {"objects": objects}, parameters=parameters.groups)
    groups = groups_of(described)
    rng = np.random.default_rng(2016)
    apart = ~np.eye(len(kinds), dtype=bool)
    for share in given.groups_per_word:
        words = VocabularyParameters(groups_per_word=share, stop_share=0.0)
        vocabulary, nearest_words = build_vocabulary(groups, described["objects"], parameters=words)
        counts = count_words(nearest_words, described["objects"], n_objects=len(files), stopped=vocabulary.stopped)
        bags = weigh_words(counts, inverse_document_frequency(counts))
        alike = similarity(bags, bags)
        np.fill_diagonal(alike, -1.0)
        nearest = kinds[alike.argmax(axis=1)]
        figures: dict[str, object] = {"groups": len(groups), "words": len(vocabulary), "objects": len(kinds)}
        figures["nearest_right"] = round(float((nearest == kinds).mean()), 3)
        for kind in np.unique(kinds):
            mine = np.flatnonzero(kinds == kind)
            if len(mine) < 2:
                continue
            found = [average_precision(alike[k, apart[k]], (kinds == kind)[apart[k]]) for k in mine]
            chance = [
                average_precision(rng.random(len(kinds) - 1), (kinds == kind)[apart[mine[0]]]) for _ in range(SHUFFLES)
            ]
            figures[str(kind)] = {
                "objects": len(mine),
                "nearest": {str(k): int((nearest[mine] == k).sum()) for k in np.unique(nearest[mine])},
                "average_precision": round(float(np.mean(found)), 3),
                "chance": round(float(np.mean(chance)), 3),
            }
        print(json.dumps(figures), flush=True)


if __name__ == "__main__":
    main()
