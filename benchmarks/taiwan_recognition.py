"""Recognisers that learned simulated objects, on poles that were cut from a survey in Taiwan.

    kedro run --pipelines=simulated_objects
    python benchmarks/taiwan_recognition.py FOLDER --methods jointnet hierarchy_descriptor

Reads the environment `taiwan_poles` for how the files are read. Pedestrian signals count as traffic lights; poles and
other objects, whose class the simulated set does not have, are left out.
"""

from __future__ import annotations

import json
from itertools import product
from pathlib import Path

import numpy as np
import yaml
from _common import CONF, configured, parser
from sydney_recognition import parameters_of

from mlsroad_pipeline.algorithms.core.classes import find_scheme
from mlsroad_pipeline.formats.options import ReadOptions
from mlsroad_pipeline.formats.registry import get_format
from mlsroad_pipeline.papers.luo2019.study.plan import BASELINES
from mlsroad_pipeline.papers.luo2019.study.sets import thin
from mlsroad_pipeline.papers.shared.recognition.object_set import ObjectSet
from mlsroad_pipeline.papers.shared.recognition.recogniser import make_recogniser, probabilities

CLASSES = {"SL": "light pole", "STL": "traffic light", "PS": "traffic light", "SS": "traffic sign"}


def read_objects(folder: Path, classes: tuple[str, ...], max_points: int) -> ObjectSet:
    environment = yaml.safe_load((CONF / "taiwan_poles/parameters.yml").read_text(encoding="utf-8"))
    options = ReadOptions(**environment["survey"]["read"])
    objects, labels, intensities = [], [], []
    for path in sorted(folder.glob("*_*.csv.gz")):
        name = CLASSES.get(path.name.partition("_")[0])
        if name is not None:
            cloud = get_format(path).read(path, options)
            objects.append(cloud.xyz)
            intensities.append(cloud["intensity"])
            labels.append(classes.index(name))
    return thin(ObjectSet.from_objects(objects, labels, intensities), max_points, seed=0)


def main() -> None:
    arguments = parser(__doc__)
    arguments.add_argument("folder", type=Path)
    arguments.add_argument("--sets", type=Path, default=Path("data/05_model_input/simulated_objects"))
    arguments.add_argument("--methods", nargs="+", default=["jointnet"])
    arguments.add_argument("--seeds", nargs="+", type=int, default=[1])
    arguments.add_argument("--changes", type=json.loads, default={})
    options = arguments.parse_args()
    scheme = find_scheme(configured("classes")["schemes"], "hdr9")
    with np.load(options.sets / "hdr9.train/result.npz") as found:
        train = ObjectSet.from_arrays(dict(found))
    test = read_objects(options.folder, scheme.classes, configured("simulated_objects")["cut"]["max_points"])
    for slug, seed in product(options.methods, options.seeds):
        method = make_recogniser(slug, parameters_of(slug, seed, options.changes))
        method.fit(train.objects, train.label, intensities=train.intensities)
        # Baselines use shape alone.
        for given in (test, ObjectSet(test.xyz, test.indptr, test.label))[slug in BASELINES :]:
            label = probabilities(method, given, len(scheme))["label"]
            by_class = {
                scheme.classes[k]: {scheme.classes[j]: int((label[test.label == k] == j).sum()) for j in found}
                for k in np.unique(test.label)
                for found in [np.unique(label[test.label == k])]
            }
            line = {"method": slug, "seed": seed, "intensity": given is test, "learned": len(train)}
            print(
                json.dumps({**line, "accuracy": round(float((label == test.label).mean()), 3), **by_class}), flush=True
            )


if __name__ == "__main__":
    main()
