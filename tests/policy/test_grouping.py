import pytest
import torch
from torch import nn

from lerobot_buds.policy.grouping import Grouping, by_group, capacities


@pytest.fixture
def networks() -> list[nn.Module]:
    torch.manual_seed(0)
    return [nn.Sequential(nn.Conv2d(2, 4, 3), nn.GroupNorm(2, 4), nn.Flatten(), nn.Linear(36, 3)) for _ in range(4)]


def computed(networks, images, grouping):
    """Outputs, and the gradients of images and parameters: None where there is none."""
    parameters = [p for network in networks for p in network.parameters()]
    (outputs,) = by_group(grouping, lambda k, rows: [networks[k](images[rows])])
    loss = (outputs * torch.arange(outputs.numel()).view_as(outputs)).sum()
    return outputs, torch.autograd.grad(loss, [images, *parameters], allow_unused=True)


def test_rows_that_fill_up_change_neither_values_nor_gradients(networks):
    number = torch.tensor([2, 0, 2, 2, 3, 0, 2])
    images = torch.rand(7, 2, 5, 5, requires_grad=True)
    padded = Grouping.padded(number, [3, 2, 5, 1])
    assert padded.numbers == (0, 1, 2, 3) and padded.sizes == (2, 0, 4, 1)
    assert [len(rows) for rows in padded.rows] == [3, 2, 5, 1]
    plain_outputs, plain = computed(networks, images, Grouping.of(number))
    outputs, gradients = computed(networks, images, padded)
    torch.testing.assert_close(outputs, plain_outputs)
    torch.testing.assert_close(outputs[:1], networks[2](images[:1]))
    for gradient, expected in zip(gradients, plain, strict=True):
        if expected is None:  # of a network without rows
            assert not gradient.any()
        else:
            torch.testing.assert_close(gradient, expected)


def test_what_has_no_room_is_not_padded():
    number = torch.tensor([0, 1, 1, 1])
    assert Grouping.padded(number, [4, 2]) is None
    assert Grouping.padded(number, [1, 3]).sizes == (1, 3)


@pytest.mark.parametrize("number", [[1], [1, 1, 1], [3, 1, 3]])
def test_groups_are_those_of_the_batch(number):
    grouping = Grouping.of(torch.tensor(number))
    assert grouping.numbers == tuple(sorted(set(number))) and sum(grouping.sizes) == len(number)
    assert (grouping.back is None) == (len(set(number)) == 1)
    (found,) = by_group(grouping, lambda k, rows: [torch.full((len(number),), k)[rows]])
    assert found.tolist() == number


def test_the_tensors_of_another_batch_take_the_place_of_those_of_one():
    one, other = (Grouping.padded(torch.tensor(number), [2, 3]) for number in ([0, 1, 1], [1, 0, 1]))
    (found,) = by_group(one.with_tensors(other.tensors), lambda k, rows: [torch.full((3,), k)[rows]])
    assert found.tolist() == [1, 0, 1]
    whole = Grouping.whole(3)
    assert whole.with_tensors(whole.tensors) is whole


def test_random_batches_have_room_and_little_is_computed_in_vain():
    shares = torch.tensor([0.4, 0.3, 0.2, 0.09, 0.01])
    counts = (2560 * shares).long()
    room = capacities(counts, 128)
    batches = torch.multinomial(shares, 2000 * 128, replacement=True).view(2000, 128)
    missed = sum(Grouping.padded(batch, room) is None for batch in batches)
    assert missed < 0.04 * len(batches) and sum(room) < 1.5 * 128
    assert capacities(torch.tensor([10, 0]), 5) == [5, 1]
