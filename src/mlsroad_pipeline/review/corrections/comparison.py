"""Comparison of a model that has learned with the one before: on answers held out by turn, and on unanswered voxels."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.inventory.objects.object_classifier import LabelledCandidates, continue_classifier
from mlsroad_pipeline.algorithms.models.boosted_trees.answer_boosting import Answer, Scored
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.model_store.object_classifiers import classifier_of, read_candidate_replay
from mlsroad_pipeline.review.corrections.learners import Learner, learner_of
from mlsroad_pipeline.review.corrections.learning import Learned, joined
from mlsroad_pipeline.review.corrections.object_answers import joined_answers

FOLDS, FEWEST = 4, 8
"""Number of trainings that leave answers out by turn, and fewest answers (or candidates of a kind) for them."""

SURE = 0.9
"""Least probability of the unanswered voxels that are expected to keep their class."""

TOLERATED, LOST, LEAST_SURE = 0.02, 0.05, 100
"""Mean share of right voxels that may be lost without a gain, share of the sure voxels of a class from which it is
named, and fewest sure voxels of a class."""

LEAST_GAIN, DRAWS, TAIL = 0.005, 2000, 0.05
"""Least share of the unanswered voxels that must become right for a better model, number of draws of the held-out
answers for the interval of this share, and probability of each tail outside the interval."""

BETTER, WORSE, SAME = "better", "worse", "no difference"


@dataclass(frozen=True)
class Comparison:
    """Rates of the model before and after the learning."""

    answers: pd.DataFrame  # Held-out answers: class, right share of their voxels `before` and `after`
    objects: pd.DataFrame  # Held-out candidates: kind, whether `before` and `after` are right
    # Sure voxels without an answer, by class: `voxels`, `changed`, and the class that most of the changed ones get
    rest: pd.DataFrame
    changed: float  # Share of all voxels without an answer that change their class

    def verdict(self) -> tuple[str, str]:
        """Return whether the new model is better, and why.

        It is worse if held-out answers get clearly worse, or if the classes lose more of their sure voxels, on the
        mean, than the held-out answers gain. It is better if held-out objects get clearly better, or if the interval
        of the share of unanswered voxels that become right lies above `LEAST_GAIN`.
        """
        said = (_said(self.answers, "voxels of held-out answers"), _said(self.objects, "held-out objects"))
        reasons = [text for text in said if text] or [f"fewer than {FEWEST} answers are too few to hold some out"]
        rest = self.rest[self.rest["voxels"] >= LEAST_SURE]
        shares = (rest["changed"] / rest["voxels"]).to_numpy(np.float64)
        reasons += [
            f"{row['changed'] / row['voxels']:.0%} of the sure {row['class']} without an answer become {row['to']}"
            for row in rest[shares > LOST].to_dict("records")
        ]
        low, high = self.expected()
        if len(self.answers):
            reasons.append(
                f"{low:+.1%} to {high:+.1%} of the other voxels become right if they gain like these answers"
            )
        reasons.append(f"{self.changed:.1%} of the voxels without an answer change class")
        gained = _gain(self.answers)
        gains = [_signed(table) for table in (self.answers, self.objects)]
        is_worse = min(gains) < 0 or (len(shares) > 0 and shares.mean() > max(gained, TOLERATED))
        is_better = gains[1] > 0 or low > LEAST_GAIN
        return WORSE if is_worse else BETTER if is_better else SAME, "; ".join(reasons)

    def expected(self) -> tuple[float, float]:
        """Return the interval of the share of unanswered voxels that become right: those that change, times the gain.

        The gain is that of the held-out answers, drawn with replacement (bootstrap).
        """
        if self.answers.empty:
            return 0.0, 0.0
        gain = (self.answers["after"] - self.answers["before"]).to_numpy(np.float64)
        drawn = np.random.default_rng(2026).integers(len(gain), size=(DRAWS, len(gain)))
        low, high = self.changed * np.quantile(gain[drawn].mean(axis=1), (TAIL, 1.0 - TAIL))
        return float(low), float(high)


def _gain(table: pd.DataFrame) -> float:
    return float((table["after"] - table["before"]).mean()) if len(table) else 0.0


def _signed(table: pd.DataFrame) -> int:
    """Return 1 for a gain, -1 for a loss: more than a standard deviation without a gain, and than `TOLERATED`."""
    difference = (table["after"] - table["before"]).to_numpy(np.float64)
    spread = np.sqrt((difference**2).sum())
    is_clear = abs(difference.sum()) > spread and abs(_gain(table)) > TOLERATED
    return int(np.sign(difference.sum())) if is_clear else 0


def _said(table: pd.DataFrame, what: str) -> str:
    if table.empty:
        return ""
    before, after = table["before"].mean(), table["after"].mean()
    return f"{before:.0%} of the {what} were right before, {after:.0%} after"


def compare_learning(bundle: ModelBundle, model: ModelBundle, data: Learned) -> Comparison:
    """Return the comparison of a model with the one that has learned from all of `data`."""
    learner = learner_of(bundle)
    names = np.array(bundle.classes)
    survey = joined(data.survey) if data.survey else None
    answers = _held_out_answers(learner, data.answers, survey, names)
    objects = _held_out_objects(bundle, joined_answers(data.objects))
    if survey is None or not data.answers or not len(survey.values):
        return Comparison(answers, objects, pd.DataFrame(columns=["class", "voxels", "changed", "to"]), 0.0)
    before, sure = learner.decided(survey.scores)
    after, _ = learner.decided(survey.scores + learner.change(model, survey.values))
    return Comparison(answers, objects, _rest(names, before, after, sure >= SURE), float((before != after).mean()))


def turns(groups: Sequence[str]) -> NDArray[np.int64]:
    """Return the fold of each answer: those of a class are dealt in turn, in a random order."""
    order = np.random.default_rng(2026).permutation(len(groups))
    order = order[np.argsort(np.array(groups)[order], kind="stable")]
    fold = np.empty(len(groups), np.int64)
    fold[order] = np.arange(len(groups)) % FOLDS
    return fold


def _held_out_answers(
    learner: Learner, answers: Sequence[Answer], survey: Scored | None, names: NDArray[np.str_]
) -> pd.DataFrame:
    """Return the right share of the voxels of each answer, before and after the learning from the other folds."""
    used = [answer for answer in answers if len(answer.values) and answer.scores is not None]
    groups = [" or ".join(names[answer.classes]) for answer in used]
    if survey is None or len(used) < FEWEST:
        return pd.DataFrame({"class": [], "before": [], "after": []}, dtype=np.float64)
    fold, rows = turns(groups), []
    for k in range(FOLDS):
        others = [answer for answer, own in zip(used, fold, strict=True) if own != k]
        model = learner.learned(others, survey, learned_from={})
        for row in np.flatnonzero(fold == k).tolist():
            answer = used[row]
            scores = np.asarray(answer.scores)
            right = [
                float(answer.classes[learner.decided(each)[0]].mean())
                for each in (scores, scores + learner.change(model, answer.values))
            ]
            rows.append((groups[row], *right))
    return pd.DataFrame(rows, columns=["class", "before", "after"])


def _held_out_objects(bundle: ModelBundle, answers: Mapping[str, LabelledCandidates]) -> pd.DataFrame:
    """Return whether the object classifier is right about each candidate, before and after the other folds."""
    classifier, replay = classifier_of(bundle), read_candidate_replay()
    rows = []
    for kind, found in answers.items():
        if len(found.values) < FEWEST:
            continue
        fold = turns([str(true) for true in found.true])
        before = classifier.probabilities(kind, found.values)[:, 0] >= 0.5
        for k in range(FOLDS):
            others, own = fold != k, fold == k
            learned = continue_classifier(
                classifier, {kind: LabelledCandidates(found.values[others], found.true[others])}, replay
            )
            after = learned.probabilities(kind, found.values[own])[:, 0] >= 0.5
            pairs = zip((before[own] == found.true[own]).tolist(), (after == found.true[own]).tolist(), strict=True)
            rows += [(kind, float(was), float(now)) for was, now in pairs]
    return pd.DataFrame(rows, columns=["kind", "before", "after"])


def _rest(
    names: NDArray[np.str_], before: NDArray[np.integer], after: NDArray[np.integer], sure: NDArray[np.bool_]
) -> pd.DataFrame:
    """Return how many sure voxels of each class change it, and what most of them become."""
    counts = np.zeros((len(names), len(names)), np.int64)
    np.add.at(counts, (before[sure], after[sure]), 1)
    voxels = counts.sum(axis=1)
    changed = voxels - counts.diagonal()
    others = counts - np.diag(counts.diagonal())
    to = np.where(changed > 0, names[others.argmax(axis=1)], "")
    table = pd.DataFrame({"class": names, "voxels": voxels, "changed": changed, "to": to})
    return table[table["voxels"] > 0].reset_index(drop=True)
