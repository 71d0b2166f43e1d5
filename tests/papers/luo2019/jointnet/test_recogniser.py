"""JointNet: layers as printed, training that repeats and resumes, and recognition of planted shapes."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
import torch

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError, ReadError
from mlsroad_pipeline.model_store.torch_checkpoints import TorchCheckpoints
from mlsroad_pipeline.papers.luo2019.jointnet import training
from mlsroad_pipeline.papers.luo2019.jointnet.inputs import Points, augment, encode
from mlsroad_pipeline.papers.luo2019.jointnet.network import Halving, JointNet, PyramidPooling
from mlsroad_pipeline.papers.luo2019.jointnet.parameters import (
    AugmentationParameters,
    InputParameters,
    JointNetParameters,
    NetworkParameters,
    TrainingParameters,
)
from mlsroad_pipeline.papers.luo2019.jointnet.recogniser import JointNetRecogniser

SMALL = NetworkParameters([4, 4, 4, 4, 8], 16, 2, 8, [4, 4], [4, 4, 8, 8], dropout=0.1)


def parameters(**training_changes):
    wanted = {"epochs": 12, "n_members": 1, "n_turns": 2, "seed": 3, **training_changes}
    return JointNetParameters(network=SMALL, training=TrainingParameters(**wanted))


def shapes(rng, n):
    """Poles, plates and balls of about the same size, 40 points each."""
    objects = []
    for _ in range(n):
        objects.append(rng.normal(size=(40, 3)) * [0.05, 0.05, 1.0])
        objects.append(rng.normal(size=(40, 3)) * [1.0, 1.0, 0.05])
        ball = rng.normal(size=(40, 3))
        objects.append(ball / np.linalg.norm(ball, axis=1, keepdims=True))
    return objects, np.array(["pole", "plate", "ball"] * n)


def flat(objects, known=True):
    counts = [len(p) for p in objects]
    indptr = np.append(0, np.cumsum(counts)).astype(np.int64)
    return Points(np.concatenate(objects), indptr, np.full(sum(counts), 0.5), np.full(len(counts), known))


def test_pyramid_pooling_takes_halves_and_the_whole():
    maps = torch.arange(32.0).reshape(1, 2, 4, 4)
    assert PyramidPooling()(maps).tolist() == [[7.0, 15.0, 23.0, 31.0, 15.0, 31.0]]


def test_scores_are_the_sum_over_the_views_and_the_convolutional_module_is_shared(rng):
    net = JointNet(JointNetParameters(), 5).eval()
    images, measures = encode(flat(shapes(rng, 2)[0]), InputParameters())
    given = {view: torch.from_numpy(v) for view, v in images.items()}
    with torch.no_grad():
        whole, alone_by_measures = net(given, torch.from_numpy(measures))
        net.views, parts = ("hssi",), []
        for view in ("hssi", "vqai", "vaai"):
            net.views = (view,)
            parts.append(net(given, torch.from_numpy(measures))[0])
    torch.testing.assert_close(whole, sum(parts))  # equation 10
    assert whole.shape == alone_by_measures.shape == (6, 5)
    alone = JointNet(JointNetParameters().with_views("vqai"), 5)
    size = {n: sum(p.numel() for p in net.parameters()) for n, net in (("all", net), ("one", alone))}
    shared = sum(p.numel() for part in (net.convolutional, net.by_measures) for p in part.parameters())
    assert size["all"] - shared == 3 * (size["one"] - shared)
    assert size["all"] * 4 < 5e6 / 2  # two members are within 5 MB


def test_layers_are_as_printed():
    net = JointNet(JointNetParameters(), 4)
    kinds = [type(layer).__name__ for layer in net.convolutional]
    assert kinds.count("Conv2d") == 5 and kinds.count("Linear") == 2 and kinds[-1] == "Unflatten"
    assert [type(layer).__name__ for layer in net.fusion_1["hssi"]].count("Conv2d") == 2
    assert [type(layer).__name__ for layer in net.fusion_2["hssi"].convolutions].count("Conv2d") == 4
    assert net.fusion_1["hssi"][0].in_channels == 5 * 4  # the whole and four slices


@pytest.mark.parametrize(
    "changes", [{}, {"bilinear": True}, {"compress": False, "intensity": False, "measures": False}]
)
def test_what_the_network_sees(rng, changes):
    objects, _ = shapes(rng, 1)
    seen = InputParameters(isotropic=False, clean=0.0, **changes)
    images, measures = encode(flat(objects), seen)
    n_channels = 2 if seen.intensity else 1
    assert [v.shape for v in images.values()] == [(3, 5, n_channels, s, s) for s in (16, 8, 16)]
    counts = images["vqai"][:, 0, 0] ** (2 if seen.compress else 1) * 4 / 64
    np.testing.assert_allclose(counts.sum(axis=(1, 2)), 1.0, atol=1e-5)
    if seen.intensity:
        cells = counts > 0
        np.testing.assert_allclose(images["vqai"][:, 0, 1][cells], 0.5, atol=1e-5)
        assert (images["vqai"][:, 0, 1][~cells] == 0).all()
        hidden = encode(flat(objects, known=False), seen)
        assert (hidden[0]["hssi"][:, :, 1] == 0).all() and (hidden[1][:, 34:] == 0).all()
    assert measures.shape == (3, 42 if seen.measures else 0)
    if seen.measures:
        heights = [np.log(np.ptp(p[:, 2]) + 0.1) for p in objects]
        np.testing.assert_allclose(measures[:, 0], heights, rtol=1e-5)


def test_a_window_lets_the_images_tell_size(rng):
    """Boxes of the same shape and of two sizes: what is seen of them is the same without a window."""
    boxes = [rng.uniform(size=(60, 3)) * [1.0, 1.0, 2.0] * size for size in (1, 2) * 6]
    classes = np.array(["small", "large"] * 6)
    plain = {"intensity": False, "measures": False}
    accuracy = {}
    for window in (None, [2.0, 4.0]):
        wanted = replace(parameters(epochs=20, schedule="one_cycle"), inputs=InputParameters(window=window, **plain))
        found = JointNetRecogniser(wanted).fit(boxes, classes)
        again = JointNetRecogniser.from_arrays(found.to_arrays(), wanted)
        others = [rng.uniform(size=(60, 3)) * [1.0, 1.0, 2.0] * size for size in (1, 2) * 20]
        accuracy[window is None] = (again.predict(others) == ["small", "large"] * 20).mean()
    assert accuracy[False] >= 0.95 and accuracy[True] <= 0.7


def test_measures_are_what_they_are_called(rng):
    points = flat([rng.uniform(size=(4000, 3)) * [4.0, 2.0, 8.0] + [4e5, 5e6, 20.0]])
    found = encode(points, InputParameters())[1][0]
    np.testing.assert_allclose(np.exp(found[:3]) - 0.1, [8, 4, 2], atol=0.15)
    np.testing.assert_allclose(np.exp(found[3:6]) - 0.05, np.array([8, 4, 2]) / np.sqrt(12), atol=0.06)
    np.testing.assert_allclose(found[6:9], [0.25, 0.5, 0.75], atol=0.03)
    np.testing.assert_allclose(np.exp(found[9:12]) - 0.05, [7.2, 3.6, 1.8], atol=0.15)
    np.testing.assert_allclose(found[12:24:3], 0.25, atol=0.03)
    np.testing.assert_allclose(np.exp(found[13:24:3]) - 0.05, 4 / np.sqrt(12), atol=0.1)
    distance = np.linalg.norm((points.xyz - points.xyz.mean(axis=0))[:, :2], axis=1)
    np.testing.assert_allclose(
        np.exp(found[24:29]) - 0.05, np.quantile(distance, [0.1, 0.25, 0.5, 0.75, 0.9]), atol=0.02
    )
    np.testing.assert_allclose(found[29:32], [0.5, 0.25, 0.25], atol=0.03)
    assert found[32] < 0.05 and found[33] > 0.99  # the last axis is level, the first upright
    np.testing.assert_allclose(found[34:], [0.5, 0, 0.5, 0.5, 0.5, 0.5, 0.5, 1.0], atol=1e-6)


def test_measures_do_not_turn_with_the_object(rng):
    points = flat(shapes(rng, 2)[0])
    one, other = (encode(p, InputParameters())[1] for p in (points, points.turned(rng.uniform(0, 6, 6))))
    np.testing.assert_allclose(one, other, atol=1e-4)
    distances = [np.linalg.norm(p.xyz[:40] - p.xyz[0], axis=1) for p in (points, points.turned(1.0))]
    np.testing.assert_allclose(*distances)


def test_augmentation_keeps_to_its_limits(rng):
    points = flat([rng.normal(size=(500, 3)), rng.normal(size=(5, 3))])
    nothing = AugmentationParameters(False, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    assert augment(points, nothing, rng).xyz.tobytes() == points.xyz.tobytes()
    thin = augment(points, AugmentationParameters(drop=0.5, scale=0.0), rng)
    assert 200 < np.diff(thin.indptr)[0] < 500 and np.diff(thin.indptr)[1] == 5
    everything = AugmentationParameters(True, 0.5, 0.5, 0.1, 0.2, 0.3, 0.5)
    one, other = (augment(points, everything, np.random.default_rng(1)) for _ in range(2))
    assert one.xyz.tobytes() == other.xyz.tobytes()
    limit = np.ptp(points.xyz, axis=0).max() * 2
    assert np.isfinite(one.xyz).all() and np.ptp(one.xyz, axis=0).max() < limit


def test_planted_shapes_are_told_apart_and_the_model_survives_as_arrays(rng):
    objects, classes = shapes(rng, 12)
    fresh, truth = shapes(rng, 5)
    found = JointNetRecogniser(parameters(epochs=15)).fit(objects, classes)
    assert (found.predict(fresh) == truth).all()
    probabilities = found.predict_proba(fresh)
    np.testing.assert_allclose(probabilities.sum(axis=1), 1.0, atol=1e-6)
    assert found.histories_[0][-1]["loss"] < 0.7 * found.histories_[0][0]["loss"]
    again = JointNetRecogniser.from_arrays(found.to_arrays(), found.parameters)
    assert again.predict_proba(fresh).tobytes() == probabilities.tobytes()
    before = torch.get_num_threads()
    torch.set_num_threads(1 if before > 1 else 2)
    assert (
        JointNetRecogniser(parameters(epochs=15)).fit(objects, classes).predict_proba(fresh).tobytes()
        == probabilities.tobytes()
    )
    torch.set_num_threads(before)
    lacking = {name: array for name, array in found.to_arrays().items() if "scores" not in name}
    with pytest.raises(DataError, match="weights do not fit jointnet with 3 classes: Missing key.*scores"):
        JointNetRecogniser.from_arrays(lacking, found.parameters)
    other = {**found.to_arrays(), "classes": np.array(["ball", "pole"])}
    with pytest.raises(DataError, match="do not fit jointnet with 2 classes: size mismatch"):
        JointNetRecogniser.from_arrays(other, found.parameters)


def test_training_that_is_killed_goes_on_as_if_it_had_not_been(rng, tmp_path, monkeypatch):
    objects, classes = shapes(rng, 6)
    wanted = parameters(epochs=14, validation=0.2)
    whole = JointNetRecogniser(wanted).fit(objects, classes)
    passes = itertools.count()
    unchanged = training._Run.pass_once

    def killed(self, epoch):
        if next(passes) == 12:
            raise KeyboardInterrupt
        unchanged(self, epoch)

    monkeypatch.setattr(training._Run, "pass_once", killed)
    with pytest.raises(KeyboardInterrupt):
        JointNetRecogniser(wanted, checkpoints=TorchCheckpoints(tmp_path)).fit(objects, classes)
    monkeypatch.setattr(training._Run, "pass_once", unchanged)
    resumed = JointNetRecogniser(wanted, checkpoints=TorchCheckpoints(tmp_path)).fit(objects, classes)
    assert resumed.histories_ == whole.histories_
    for name, array in whole.to_arrays().items():
        assert array.tobytes() == resumed.to_arrays()[name].tobytes(), name
    with pytest.raises(ReadError, match=r"network_0.pt is a checkpoint of another training"):
        JointNetRecogniser(parameters(epochs=9), checkpoints=TorchCheckpoints(tmp_path)).fit(objects, classes)
    (tmp_path / "network_0.pt").write_bytes(b"PK\x03\x04 nothing")
    with pytest.raises(ReadError, match=r"network_0.pt: the checkpoint is damaged"):
        JointNetRecogniser(wanted, checkpoints=TorchCheckpoints(tmp_path)).fit(objects, classes)


def test_early_stopping_keeps_the_best_network(rng):
    objects, classes = shapes(rng, 6)
    rng.shuffle(classes)  # nothing to learn, so that the held-out loss soon grows
    found = JointNetRecogniser(parameters(epochs=60, patience=3, validation=0.3)).fit(objects, classes)
    losses = [entry["validation_loss"] for entry in found.histories_[0]]
    assert len(losses) < 60 and int(np.argmin(losses)) == len(losses) - 4


def test_rates_follow_the_schedules():
    halving = TrainingParameters(schedule="halving", learning_rate=0.01)
    assert [training.scheduled_rate(0, 10, e, halving) for e in (0, 19, 20, 40)] == [0.01, 0.01, 0.005, 0.0025]
    rates = [training.scheduled_rate(i, 100, 0, TrainingParameters(learning_rate=1.0)) for i in range(100)]
    assert np.argmax(rates) == 20 and rates[20] == 1.0 and rates[0] == pytest.approx(0.04) and rates[-1] < 0.001


def test_no_step_is_longer_than_the_clipped_gradient_allows(rng):
    objects, classes = shapes(rng, 4)

    def weights_after_one_step(clip):
        wanted = parameters(epochs=1, clip=clip, learning_rate=0.1, schedule="halving", momentum=0.0, weight_decay=0.0)
        (network,) = JointNetRecogniser(wanted).fit(objects, classes).networks_
        return torch.cat([weights.detach().flatten() for weights in network.parameters()])

    start = weights_after_one_step(1e-12)
    short, free = (float((weights_after_one_step(clip) - start).norm()) for clip in (0.01, 0.0))
    assert short == pytest.approx(0.1 * 0.01, rel=1e-3)
    assert free > 10 * short
    with pytest.raises(ParameterError, match=r"training\.clip .*got -1\.0"):
        parameters(clip=-1.0)


@pytest.mark.parametrize("n_points", [1, 2, 30])
def test_objects_of_hardly_any_points_get_a_class(rng, n_points):
    objects, classes = shapes(rng, 3)
    found = JointNetRecogniser(parameters(epochs=1)).fit(objects, classes, intensities=[np.ones(40)] * 9)
    few = [np.full((n_points, 3), 2.0)]
    for given in (None, [np.full(n_points, 0.3)]):
        probabilities = found.predict_proba(few, intensities=given)
        assert np.isfinite(probabilities).all() and probabilities.sum() == pytest.approx(1.0)
    assert found.predict_proba([]).shape == (0, 3)
    with pytest.raises(DataError, match=r"object 0 .*got 0"):
        found.predict_proba([np.zeros((0, 3))])
    with pytest.raises(DataError, match="object 0 has 1 points with NaN"):
        found.predict_proba([np.array([[0, 0, np.nan]])])


def test_bad_input_is_named(rng):
    objects, classes = shapes(rng, 2)
    with pytest.raises(DataError, match=r"jointnet .*got .'pole'. alone"):
        JointNetRecogniser(parameters()).fit(objects, ["pole"] * 6)
    with pytest.raises(DataError, match=r"classes .*got \(5,\)"):
        JointNetRecogniser(parameters()).fit(objects, classes[:5])
    with pytest.raises(ParameterError, match=r"inputs.views .*got .'side'."):
        InputParameters(views=["side"])
    for window, told in ([2.0], r"two lengths, got \[2.0\]"), ([2.0, 0.0], "a finite number > 0, got 0.0"):
        with pytest.raises(ParameterError, match=f"inputs.window must be {told}"):
            InputParameters(window=window)
    with pytest.raises(ParameterError, match=r"training.schedule .*got 'steps'"):
        TrainingParameters(schedule="steps")
    with pytest.raises(ParameterError, match="network.cnn3_widths must be 4 numbers"):
        NetworkParameters(cnn3_widths=[4])
    if not torch.cuda.is_available():
        with pytest.raises(ParameterError, match="PyTorch finds no GPU"):
            JointNetRecogniser(parameters(device="cuda")).fit(objects, classes)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_a_gpu_learns_the_same_shapes(rng):
    objects, classes = shapes(rng, 12)
    found = JointNetRecogniser(parameters(epochs=15, device="cuda")).fit(objects, classes)
    fresh, truth = shapes(rng, 5)
    assert (found.predict(fresh) == truth).all()


@pytest.mark.parametrize("shape", [(8, 8), (7, 8), (1, 3)])
def test_halving_is_max_pooling_in_training_and_out_of_it(shape):
    maps = torch.randn(2, 3, *shape)
    wanted = torch.nn.functional.max_pool2d(maps, 2, ceil_mode=True)
    for pool in (Halving().train(), Halving().eval()):
        assert torch.equal(pool(maps), wanted)
