import numpy as np
import pytest
import torch

from mlsroad_pipeline.algorithms.image_labels.muon import Muon, orthogonalised


def by_singular_values(matrix, rounds):
    """The quintic iteration on each singular value by itself."""
    left, values, right = np.linalg.svd(matrix, full_matrices=False)
    values = values / np.linalg.norm(values)
    for _ in range(rounds):
        values = 3.4445 * values - 4.7750 * values**3 + 2.0315 * values**5
    return left @ np.diag(values) @ right


@pytest.mark.parametrize("shape", [(6, 40), (40, 6), (9, 9), (1, 5)])
@pytest.mark.parametrize("rounds", [1, 5])
def test_singular_values_are_iterated_and_vectors_are_kept(shape, rounds):
    matrix = np.random.default_rng(0).normal(size=shape)
    out = orthogonalised(torch.from_numpy(matrix), rounds).numpy()
    np.testing.assert_allclose(out, by_singular_values(matrix, rounds), atol=1e-6)


def test_five_rounds_bring_singular_values_near_one_in_single_precision():
    rng = np.random.default_rng(1)
    left, right = (np.linalg.qr(rng.normal(size=(size, 32)))[0] for size in (32, 300))
    matrix = left @ np.diag(np.geomspace(1, 0.02, 32)) @ right.T
    values = torch.linalg.svdvals(orthogonalised(torch.from_numpy(matrix.astype(np.float32))))
    assert float(values.min()) > 0.67 and float(values.max()) < 1.21


def test_nothing_to_follow_changes_nothing():
    assert not orthogonalised(torch.zeros(3, 7)).any()


@pytest.mark.parametrize("last", [False, True])
def test_steps_are_momentum_orthogonalised_with_the_size_of_adamw(last):
    rng = np.random.default_rng(2)
    start, gradients = rng.normal(size=(4, 3, 2, 2)), rng.normal(size=(3, 4, 3, 2, 2))
    kernel = torch.nn.Parameter(torch.from_numpy(start.copy()))
    if last:  # channels last in memory
        kernel = torch.nn.Parameter(kernel.detach().to(memory_format=torch.channels_last))
    optimiser = Muon([kernel], 0.1, 0.9, 0.5)
    expected, mean = start.reshape(4, 12), np.zeros((4, 12))
    for gradient in gradients.reshape(3, 4, 12):
        kernel.grad = torch.from_numpy(gradient.reshape(kernel.shape))
        optimiser.step()
        mean = 0.9 * mean + 0.1 * gradient
        step = by_singular_values(0.1 * gradient + 0.9 * mean, 5)
        expected = expected * (1 - 0.1 * 0.5) - 0.1 * 0.2 * np.sqrt(12) * step
    np.testing.assert_allclose(kernel.detach().numpy().reshape(4, 12), expected, atol=1e-6)


def test_other_kernels_without_gradient_stay_and_a_closure_is_called():
    kernels = [torch.nn.Parameter(torch.ones(2, 3)) for _ in range(2)]
    optimiser = Muon(kernels, 0.1)

    def closure():
        optimiser.zero_grad()
        loss = (kernels[0] ** 2).sum()
        loss.backward()
        return loss.item()

    assert optimiser.step(closure) == 6.0
    assert torch.equal(kernels[1], torch.ones(2, 3)) and (kernels[0] < 1).all()
