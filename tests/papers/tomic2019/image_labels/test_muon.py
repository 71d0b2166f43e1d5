import numpy as np
import pytest
import torch

from mlsroad_pipeline.papers.tomic2019.image_labels.pspnet_training import ROUNDS, Muon, orthogonalised


def by_singular_values(matrix):
    """The rounds on each singular value by itself."""
    left, values, right = np.linalg.svd(matrix, full_matrices=False)
    values = values / np.linalg.norm(values)
    for linear, cubic, quintic in ROUNDS:
        values = linear * values + cubic * values**3 + quintic * values**5
    return left @ np.diag(values) @ right


@pytest.mark.parametrize("shape", [(6, 40), (40, 6), (9, 9), (1, 5)])
def test_singular_values_are_iterated_and_vectors_are_kept(shape):
    matrix = np.random.default_rng(0).normal(size=shape)
    np.testing.assert_allclose(orthogonalised(torch.from_numpy(matrix)).numpy(), by_singular_values(matrix), atol=1e-4)


@pytest.mark.parametrize(("least", "low"), [(0.02, 0.9), (0.004, 0.2)])
def test_singular_values_come_near_one_in_single_precision(least, low):
    rng = np.random.default_rng(1)
    left, right = (np.linalg.qr(rng.normal(size=(size, 32)))[0] for size in (32, 300))
    shares = np.geomspace(least, 0.3, 32)
    shares[-1] = np.sqrt(1 - (shares[:-1] ** 2).sum())  # a norm of 1
    values = torch.linalg.svdvals(orthogonalised(torch.from_numpy((left * shares @ right.T).astype(np.float32))))
    assert float(values.min()) > low and float(values.max()) < 1.1


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
        step = by_singular_values(0.1 * gradient + 0.9 * mean)
        expected = expected * (1 - 0.1 * 0.5) - 0.1 * 0.2 * np.sqrt(12) * step
    np.testing.assert_allclose(kernel.detach().numpy().reshape(4, 12), expected, atol=1e-6)


def test_kernels_without_gradient_stay():
    kernels = [torch.nn.Parameter(torch.ones(2, 3)) for _ in range(2)]
    (kernels[0] ** 2).sum().backward()
    Muon(kernels, 0.1).step()
    assert torch.equal(kernels[1], torch.ones(2, 3)) and (kernels[0] < 1).all()
