"""Inputs that the fuzzer kept, since they reach branches that others do not: refused in one line, or read right."""

from contextlib import suppress

import pytest
from helpers.fuzz_targets import corpus, n_kept, targets

from mlsroad_pipeline.algorithms.core.exceptions import MlsRoadError


@pytest.mark.parametrize("group", ["readers", "requests", "imports"])
def test_kept_inputs_are_refused_or_read(tmp_path, group):
    n_inputs = 0
    for target in targets(group, tmp_path):
        name = target.path.relative_to(tmp_path).as_posix()
        for content in (*target.seeds, *corpus(group, name)):
            with suppress(MlsRoadError):
                target.read(content)
            n_inputs += content not in target.seeds
    assert n_inputs == n_kept(group) > 10
