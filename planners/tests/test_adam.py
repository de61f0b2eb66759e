"""Our Adam is torch's, bit for bit, without what torch's loads."""

import subprocess
import sys

import pytest
import torch
from athrl_planners.updates.adam import Adam

SHAPES = ((7, 5), (5,), (3, 2, 4, 4))


def parameters(seed: int) -> list[torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    return [torch.randn(shape, generator=generator).requires_grad_() for shape in SHAPES]


def gradients(step: int) -> list[torch.Tensor | None]:
    """Other ones at each step; every third time a parameter has none."""
    generator = torch.Generator().manual_seed(1000 + step)
    made: list[torch.Tensor | None] = [torch.randn(shape, generator=generator) for shape in SHAPES]
    if step % 3 == 2:
        made[1] = None
    return made


def train(optimiser: Adam | torch.optim.Adam, trained: list[torch.Tensor], steps: range) -> None:
    for step in steps:
        for parameter, gradient in zip(trained, gradients(step), strict=True):
            parameter.grad = gradient
        optimiser.step()
        assert isinstance(optimiser, torch.optim.Adam) or all(each.grad is None for each in trained)


def same(one: list[torch.Tensor], other: list[torch.Tensor]) -> bool:
    return all(map(torch.equal, one, other))


def test_steps_are_those_of_torch_bit_for_bit() -> None:
    ours, theirs = parameters(1), parameters(1)
    adam, peer = Adam(ours, 3e-4), torch.optim.Adam(theirs, 3e-4, fused=True)
    train(adam, ours, range(20))
    train(peer, theirs, range(20))
    assert same(ours, theirs)
    assert not same(ours, parameters(1))
    state, peers = adam.state_dict()["state"], peer.state_dict()["state"]
    for place in range(len(SHAPES)):
        assert same(list(state[place].values()), [peers[place][name] for name in state[place]])


@pytest.mark.parametrize("before", [0, 6])
def test_training_continues_from_a_state_of_torch(before: int) -> None:
    """Checkpoints of earlier releases hold one; it has no moments before the first step."""
    theirs = parameters(1)
    peer = torch.optim.Adam(theirs, 3e-4, fused=True)
    train(peer, theirs, range(before))
    ours = [parameter.detach().clone().requires_grad_() for parameter in theirs]
    adam = Adam(ours, 3e-4)
    adam.load_state_dict(peer.state_dict())
    train(peer, theirs, range(before, 12))
    train(adam, ours, range(before, 12))
    assert same(ours, theirs)


def test_restored_moments_are_not_shared() -> None:
    ours = parameters(1)
    adam = Adam(ours, 3e-4)
    train(adam, ours, range(3))
    saved = adam.state_dict()
    other = parameters(1)
    successor = Adam(other, 3e-4)
    successor.load_state_dict(saved)
    kept = [moment.clone() for state in saved["state"].values() for moment in state.values()]
    train(successor, other, range(3, 6))
    assert same(kept, [moment for state in saved["state"].values() for moment in state.values()])


@pytest.mark.parametrize("wrong", ["fewer", "another shape"])
def test_state_of_other_parameters_is_refused(wrong: str) -> None:
    ours = parameters(1)
    state = Adam(ours[:2] if wrong == "fewer" else [*ours[:2], torch.zeros(4)], 3e-4).state_dict()
    with pytest.raises(ValueError, match="optimiser's"):
        Adam(ours, 3e-4).load_state_dict(state)


def test_training_does_not_load_torchs_compiler() -> None:
    """It would take a second of every learner's start, and so of the time until a killed one is back."""
    program = """
import sys, torch
from athrl_planners.updates.adam import Adam
parameter = torch.ones(3).requires_grad_()
parameter.grad = torch.ones(3)
torch.nn.utils.clip_grad_norm_([parameter], 1.0)
adam = Adam([parameter], 0.1)
adam.step()
adam.load_state_dict(adam.state_dict())
print([name for name in ("torch._dynamo", "sympy", "triton") if name in sys.modules])
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120)
    assert done.stdout.strip() == "[]", done.stderr
