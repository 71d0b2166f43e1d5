import numpy as np
import pytest
from sklearn.metrics import f1_score

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.papers.tomic2019.fusion.two_methods import ClassPreference, count_agreement


def planted(rng, n, matrix):
    """Return truth and labels drawn from a confusion matrix of counts."""
    matrix = np.asarray(matrix, dtype=float)
    truth = rng.integers(0, len(matrix), n)
    rows = matrix / matrix.sum(axis=1, keepdims=True)
    labels = (rows.cumsum(axis=1)[truth] < rng.random(n)[:, None]).sum(axis=1)
    return truth, labels


def test_scores_are_those_of_scikit_learn_over_the_points_that_are_labelled(rng):
    truth, labels = planted(rng, 3000, [[8, 1, 1], [2, 5, 3], [0, 1, 9]])
    unseen = rng.random(3000) < 0.4
    rule = ClassPreference.fit([labels, np.where(unseen, -1, labels)], truth, n_classes=4)
    expected = [
        f1_score(t, p, average=None, labels=[0, 1, 2]) for t, p in ((truth, labels), (truth[~unseen], labels[~unseen]))
    ]
    np.testing.assert_allclose(rule.f1[:, :3], expected)
    assert rule.f1[:, 3].tolist() == [0, 0]  # a class that nobody met has no F1


def test_labels_of_the_preferred_labeller_go_before_others():
    """The paper's Table 5: people, whom the images know with an F1 of 0.164, keep their labels against all others."""
    f1 = np.array([[0.84, 0.62, 0.0, 0.3], [0.93, 0.86, 0.16, 0.1]])
    rule = ClassPreference(f1)
    assert rule.preferred.tolist() == [1, 1, 1, 0]
    # Preferred against not; not against preferred; both preferred; neither; the same; one alone.
    first, second = np.array([0, 3, 3, 0, 1, 0, -1]), np.array([2, 3, 0, 3, 1, -1, 2])
    label, labeller = rule.fuse([first, second])
    assert label.tolist() == [2, 3, 0, 0, 1, 0, 2]
    assert labeller.tolist() == [1, 0, 1, 0, 1, 0, 1]
    assert rule.fuse([[3], [2]])[0].tolist() == [3]  # 0.3 against 0.16, both preferred
    assert ClassPreference(f1, delegate=False).fuse([first, second])[0].tolist() == [0, 3, 0, 0, 1, 0, 2]


def test_the_rule_is_the_one_told_in_words(rng):
    """Against a slow reference: preferred labellers first, then the higher F1, then the first labeller."""
    f1 = rng.integers(0, 5, (3, 4)) / 5
    labels = rng.integers(-1, 4, (3, 400))
    label, labeller = ClassPreference(f1).fuse(list(labels))
    for point in range(400):
        ranked = [
            (f1[k, c] == f1[:, c].max() and not (f1[:k, c] == f1[:, c].max()).any(), f1[k, c], -k)
            for k, c in enumerate(labels[:, point])
            if c >= 0
        ]
        winner = -max(ranked)[2] if ranked else -1
        assert labeller[point] == winner and label[point] == (labels[winner, point] if ranked else -1)


def test_without_delegation_a_contradiction_goes_to_the_label_with_the_higher_f1():
    rule = ClassPreference(np.array([[0.9, 0.3, 0.5], [0.6, 0.8, 0.5]]), delegate=False)
    first, second = np.array([0, 1, 2, 1, 0, -1, -1, 2]), np.array([1, 0, 0, 1, -1, 2, -1, 2])
    label, labeller = rule.fuse([first, second])
    # 0.9 of class 0 beats 0.8 of class 1; 0.3 of class 1 loses to 0.6; 0.5 of class 2 loses to 0.6.
    assert label.tolist() == [0, 0, 0, 1, 0, 2, -1, 2]
    assert labeller.tolist() == [0, 1, 1, 1, 0, 1, -1, 0]
    assert rule.preferred.tolist() == [0, 1, 0]


def test_ties_go_to_the_first_labeller():
    rule = ClassPreference(np.array([[0.5, 0.5], [0.5, 0.5]]))
    assert rule.fuse([[0], [1]])[0].tolist() == [0] and rule.fuse([[1], [0]])[0].tolist() == [1]


def test_each_class_comes_from_the_labeller_that_knows_it(rng):
    """One labeller knows classes 0 and 1, the other 2 and 3; what each does not know it gives to its own at random."""
    strong, weak = np.eye(2), np.full((2, 2), 0.5)
    first = np.block([[strong, np.zeros((2, 2))], [weak * 0.3, weak * 0.7]])
    second = np.block([[weak * 0.7, weak * 0.3], [np.zeros((2, 2)), strong]])
    truth = rng.integers(0, 4, 20_000)
    labels = [(table.cumsum(axis=1)[truth] < rng.random(20_000)[:, None]).sum(axis=1) for table in (first, second)]
    half = 10_000
    rule = ClassPreference.fit([given[:half] for given in labels], truth[:half], n_classes=4)
    assert rule.preferred.tolist() == [0, 0, 1, 1]
    fused, _ = rule.fuse([given[half:] for given in labels])
    accuracy = [np.mean(given[half:] == truth[half:]) for given in labels]
    assert np.mean(fused == truth[half:]) > max(accuracy) + 0.1


def test_three_cameras_are_chosen_among_as_two_methods_are():
    rule = ClassPreference(np.array([[0.2, 0.9], [0.7, 0.1], [0.6, 0.5]]))
    label, camera = rule.fuse([[1, -1, 0, -1], [0, -1, 1, -1], [0, 1, 0, -1]])
    assert label.tolist() == [1, 1, 0, -1] and camera.tolist() == [0, 2, 2, -1]


def test_redundancy_counts_who_labels_a_point_and_who_agrees():
    labels = [[0, 0, -1, 1, -1], [0, 1, 1, 1, -1]]
    table = count_agreement(labels, [0, 0, 1, 0, -1])
    # No labels; one that agrees; two of which none, one and both agree.
    assert table.tolist() == [[1, 0, 0], [0, 1, 0], [1, 1, 1]]
    assert table.sum() == 5


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: ClassPreference.fit([], [0, 1], n_classes=2), "at least one labeller"),
        (lambda: ClassPreference.fit([[0]], [0, 1], n_classes=2), r"shape \(2,\) as the reference, got \(1,\)"),
        (lambda: ClassPreference(np.ones((2, 2))).fuse([[0], [0], [0]]), "2 labellers of one length, got 3 of"),
        (lambda: ClassPreference(np.ones((2, 2))).fuse([[0], [2]]), "labels must be in -1..1, got 0..2"),
        (lambda: count_agreement([[0, 1]], [0]), "1 fused labels for 2 points"),
    ],
)
def test_labels_that_do_not_fit_are_named(call, message):
    with pytest.raises(DataError, match=message):
        call()
