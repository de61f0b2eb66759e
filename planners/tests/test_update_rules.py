"""Update rules on networks that say what the test wants, against their papers' formulas and torch's own."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from athrl_planners import LevelPlan
from athrl_planners.settings import ActorCriticSettings, QLearningSettings
from athrl_planners.updates import LevelNetworks, UpdateRule, make_rule, make_values
from athrl_planners.updates.noise import NoiseSource
from athrl_spaces import Continuous, Discrete
from torch import Tensor, nn

NOTHING = torch.zeros(1, 0)
SPEED = Continuous("target_speed", "m/s", 0.0, 8.0)
ANGLE = Continuous("waypoint_angle", "rad", -0.5, 0.5)
CHOICE = Discrete("behaviour", ("stop", "slow", "drive"))


class Says(nn.Module):
    """A network with a fixed answer to each row, or one that is computed; it keeps what it was asked."""

    def __init__(self, answer: Tensor | Callable[..., Tensor]) -> None:
        super().__init__()
        self.answer = answer
        self.asked: list[tuple[Tensor, ...]] = []

    def forward(self, *inputs: Tensor) -> Tensor:
        self.asked.append(inputs)
        return self.answer(*inputs) if callable(self.answer) else self.answer


def numbers(update_rule: Any, **changes: Any) -> UpdateRule:
    settings = ActorCriticSettings(update_rule=update_rule, critic="scalar", **changes)
    plan = LevelPlan("trajectory", (SPEED, ANGLE), update_rule)
    noise = NoiseSource(1, torch.device("cpu"))
    return make_rule(update_rule)(plan, settings, make_values(settings), (1, 0), noise)


def choices(**changes: Any) -> UpdateRule:
    settings = QLearningSettings(critic="scalar", **changes)
    plan = LevelPlan("behaviour", (CHOICE,), "dqn")
    noise = NoiseSource(1, torch.device("cpu"))
    return make_rule("dqn")(plan, settings, make_values(settings), (4, 0), noise)


def q(*values: float) -> Says:
    """A critic of three choices: [1, 3, 1]."""
    return Says(torch.tensor(values).view(1, 3, 1))


def next_decision(rule: UpdateRule, target: list[nn.Module], online: list[nn.Module]) -> tuple[int, float]:
    """The choice of a target, and its value."""
    step = rule.next_step(
        LevelNetworks(None, target), LevelNetworks(None, online), (NOTHING, NOTHING), NOTHING
    )
    return int(step.action.argmax()), float(rule.values.mean(step.output()))


def test_plain_dqn_takes_the_target_networks_own_best() -> None:
    assert next_decision(choices(double=False), [q(1, 5, 3)], [q(9, 0, 0)]) == (1, 5.0)


def test_double_dqn_asks_the_online_network_for_the_choice_and_the_target_for_its_value() -> None:
    assert next_decision(choices(double=True), [q(1, 5, 3)], [q(0, 0, 9)]) == (2, 3.0)


def test_of_two_critics_the_smaller_value_of_the_choice_counts() -> None:
    online: list[nn.Module] = [q(0, 0, 9), q(9, 0, 0)]  # the first one chooses
    assert next_decision(choices(double=True), [q(1, 5, 3), q(7, 7, 2)], online) == (2, 2.0)
    assert next_decision(choices(double=True), [q(1, 5, 3), q(7, 7, 4)], online) == (2, 3.0)


def test_dueling_values_are_the_states_and_the_advantages_without_their_mean() -> None:
    rule = choices(dueling=True, critics=1, head_features=8)
    (critic,) = rule.make_networks().critics
    assert isinstance(critic.state, nn.Module)
    context = torch.randn(6, 4)
    nothing = torch.zeros(6, 0)
    value, advantage = critic.state(context), critic.advantage(context)
    expected = value + advantage - advantage.mean(dim=1, keepdim=True)
    torch.testing.assert_close(critic(context, nothing).squeeze(-1), expected)
    plain = choices(dueling=False, critics=1, head_features=8).make_networks().critics[0]
    torch.testing.assert_close(plain(context, nothing).squeeze(-1), plain.advantage(context))


def test_choices_are_written_as_one_among_zeros_and_read_back() -> None:
    rule = choices()
    index = torch.tensor([[2.0], [0.0], [1.0]])
    assert rule.encode(index).tolist() == [[0, 0, 1], [1, 0, 0], [0, 1, 0]]
    assert torch.equal(rule.decode(rule.encode(index)), index)
    output = torch.tensor([[[1.0], [2.0], [3.0]]]).expand(3, 3, 1)
    assert rule.value_of(Says(output), NOTHING, NOTHING, rule.encode(index)).squeeze(-1).tolist() == [3, 1, 2]


def test_numbers_are_normalised_by_their_ranges_and_read_back() -> None:
    rule = numbers("ddpg")
    physical = torch.tensor([[0.0, 0.5], [4.0, 0.0], [6.0, -0.25]])
    torch.testing.assert_close(rule.encode(physical), torch.tensor([[-1.0, 1.0], [0.0, 0.0], [0.5, -0.5]]))
    torch.testing.assert_close(rule.decode(rule.encode(physical)), physical)


def next_step(rule: UpdateRule, actor: Tensor, *critics: Says) -> Any:
    networks = LevelNetworks(Says(actor), list(critics))
    nothing = torch.zeros(len(actor), 0)
    return rule.next_step(networks, networks, (nothing, nothing), nothing)


def test_ddpg_values_the_target_actors_action_as_it_is() -> None:
    critic = Says(torch.tensor([[3.0]]))
    step = next_step(numbers("ddpg", action_reach=1.0), torch.tensor([[0.3, -2.0]]), critic)
    torch.testing.assert_close(step.action, torch.tanh(torch.tensor([[0.3, -2.0]])))
    assert float(step.output()) == 3
    assert torch.equal(critic.asked[0][-1], step.action)
    assert step.bonus is None


def test_td3_counts_the_smaller_critic_row_by_row() -> None:
    one, other = Says(torch.tensor([[3.0], [1.0]])), Says(torch.tensor([[2.0], [5.0]]))
    assert next_step(numbers("td3"), torch.zeros(2, 2), one, other).output().tolist() == [[2.0], [1.0]]


def test_td3_smooths_target_actions_with_clipped_noise() -> None:
    critic = Says(torch.zeros(20_000, 1))
    step = next_step(numbers("td3", td3_target_noise=0.1), torch.zeros(20_000, 2), critic)
    noise = step.action
    assert float(noise.abs().max()) == pytest.approx(2.5 * 0.1)
    normal = torch.distributions.Normal(0.0, 0.1)
    inside = float((noise.abs() < 0.1).float().mean())
    assert inside == pytest.approx(float(1 - 2 * normal.cdf(torch.tensor(-0.1))), abs=0.01)
    assert float(noise.std()) == pytest.approx(0.1, rel=0.05)
    step.output()
    assert torch.equal(critic.asked[0][-1], noise)


def test_td3_keeps_smoothed_actions_in_their_range() -> None:
    step = next_step(numbers("td3"), torch.full((500, 2), 9.0), Says(torch.zeros(500, 1)))
    assert float(step.action.max()) == 1
    assert float(step.action.min()) < 1


def test_actor_is_delayed_in_td3_alone() -> None:
    delays = {rule: numbers(rule, td3_actor_delay=3).actor_delay for rule in ("ddpg", "td3", "sac")}
    assert delays == {"ddpg": 1, "td3": 3, "sac": 1}
    assert choices().actor_delay == 0


def test_deterministic_actor_climbs_the_first_critic_less_its_penalty() -> None:
    rule = numbers("td3", saturation_penalty=0.5)
    critics: list[nn.Module] = [Says(torch.tensor([[3.0]])), Says(torch.tensor([[1.0]]))]
    networks = LevelNetworks(Says(torch.tensor([[0.3, -2.0]])), critics)
    objective = rule.objective(networks, NOTHING, NOTHING)
    assert float(objective.gain) == pytest.approx(3 - 0.5 * (0.09 + 4))
    assert float(rule.objective(networks, NOTHING, NOTHING, penalised=False).gain) == 3


@pytest.mark.parametrize("reach", [1.0, 1.1])
def test_a_reach_beyond_the_range_lets_an_actor_decide_its_ends(reach: float) -> None:
    rule = numbers("td3", action_reach=reach, td3_target_noise=0.0)
    raw = torch.tensor([[-1.6, 0.5]])  # tanh(-1.6) is -0.92
    networks = LevelNetworks(Says(raw), [Says(torch.tensor([[3.0]]))])
    expected = torch.tensor([[max(-1.0, reach * math.tanh(-1.6)), reach * math.tanh(0.5)]])
    torch.testing.assert_close(next_step(rule, raw, Says(torch.zeros(1, 1))).action, expected)
    torch.testing.assert_close(rule.objective(networks, NOTHING, NOTHING).action, expected)
    decided = rule.decide(Says(raw), NOTHING, NOTHING, None)
    torch.testing.assert_close(decided, rule.decode(expected))
    assert (float(decided[0, 0]) == 0) is (reach > 1)  # the car stands


def soft_case() -> tuple[Tensor, torch.distributions.Distribution]:
    """An actor's output, and torch's own description of what it decides."""
    output = torch.tensor([[0.4, -1.0, 0.2, -0.6], [1.5, 0.0, 0.9, 0.1]])
    mean, raw = output.chunk(2, dim=1)
    deviation = (-5 + 6 * (torch.tanh(raw) + 1) / 2).exp()
    base = torch.distributions.Normal(mean, deviation)
    return output, torch.distributions.TransformedDistribution(
        base, [torch.distributions.TanhTransform(cache_size=1)]
    )


def test_sac_adds_the_entropy_of_the_next_action() -> None:
    rule = numbers("sac", sac_temperature=0.3)
    output, distribution = soft_case()
    step = next_step(rule, output, Says(torch.tensor([[3.0], [1.0]])), Says(torch.tensor([[2.0], [5.0]])))
    expected = -0.3 * distribution.log_prob(step.action).sum(dim=1)
    torch.testing.assert_close(step.bonus, expected, rtol=1e-4, atol=1e-4)
    assert step.output().tolist() == [[2.0], [1.0]]


def test_sac_draws_actions_of_the_actors_distribution() -> None:
    rule = numbers("sac")
    output = soft_case()[0][:1].expand(20_000, 4)
    drawn = torch.atanh(next_step(rule, output, Says(torch.zeros(20_000, 1))).action)
    mean, raw = output[0].chunk(2)
    deviation = (-5 + 6 * (torch.tanh(raw) + 1) / 2).exp()
    torch.testing.assert_close(drawn.mean(dim=0), mean, atol=0.02, rtol=0)
    torch.testing.assert_close(drawn.std(dim=0), deviation, atol=0.01, rtol=0.02)


def test_sac_actor_climbs_the_smaller_critic_and_the_entropy() -> None:
    rule = numbers("sac", sac_temperature=0.3, sac_target_entropy=0.0)
    output, distribution = soft_case()
    critics: list[nn.Module] = [
        Says(lambda context, above, action: action.sum(dim=1, keepdim=True)),
        Says(torch.tensor([[0.5], [0.5]])),
    ]
    objective = rule.objective(LevelNetworks(Says(output), critics), torch.zeros(2, 0), torch.zeros(2, 0))
    log_density = distribution.log_prob(objective.action).sum(dim=1)
    value = objective.action.sum(dim=1).clamp(max=0.5)
    # The temperature's own term is there for its gradient.
    term = math.log(0.3) * log_density
    torch.testing.assert_close(objective.gain, value - 0.3 * log_density + term, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize(("wanted", "rises"), [(-20.0, False), (0.69, True)])
def test_sac_temperature_rises_while_there_is_too_little_entropy(wanted: float, rises: bool) -> None:
    rule = numbers("sac", sac_target_entropy=wanted)
    networks = LevelNetworks(Says(soft_case()[0]), [Says(torch.zeros(2, 1))])
    gain = rule.objective(networks, torch.zeros(2, 0), torch.zeros(2, 0)).gain.mean()
    (gradient,) = torch.autograd.grad(gain, rule.log_temperature)
    assert (float(gradient) > 0) is rises


def test_sac_temperature_learns_from_a_decision_as_much_as_it_counts() -> None:
    """Not from padding, and not where a decision is only held: their weights are 0."""
    rule = numbers("sac")
    output, distribution = soft_case()
    networks = LevelNetworks(Says(output), [Says(torch.zeros(2, 1))])
    objective = rule.objective(networks, torch.zeros(2, 0), torch.zeros(2, 0))
    (gradient,) = torch.autograd.grad(objective.gain @ torch.tensor([0.0, 1.0]), rule.log_temperature)
    log_density = distribution.log_prob(objective.action).sum(dim=1)
    assert float(gradient) == pytest.approx(float(log_density[1]) + 2 * -1.0, abs=1e-3)


def test_sac_decides_its_mean_unless_it_is_given_noise() -> None:
    rule = numbers("sac")
    output = torch.tensor([[0.4, -1.0, 0.2, -0.6]])
    actor = Says(output)
    mean = rule.decide(actor, NOTHING, NOTHING, None)
    np.testing.assert_allclose(rule.encode(mean), torch.tanh(output[:, :2]), atol=1e-6)
    noise = torch.tensor([[1.0, -2.0]])
    deviation = (-5 + 6 * (torch.tanh(output[:, 2:]) + 1) / 2).exp()
    noisy = rule.encode(rule.decide(actor, NOTHING, NOTHING, noise))
    np.testing.assert_allclose(noisy, torch.tanh(output[:, :2] + deviation * noise), atol=1e-6)


def test_rules_for_numbers_and_for_choices_refuse_each_others_levels() -> None:
    settings = ActorCriticSettings()
    values, noise = make_values(settings), NoiseSource(1, torch.device("cpu"))
    plan = LevelPlan("behaviour", (CHOICE,), "td3")
    with pytest.raises(ValueError, match="level behaviour learns by td3 and decides a choice: use dqn"):
        make_rule("td3")(plan, settings, values, (4, 0), noise)
    for actions in ((SPEED,), (CHOICE, CHOICE)):
        plan = LevelPlan("mixed", actions, "dqn")
        with pytest.raises(ValueError, match="level mixed learns by dqn: it should decide one choice"):
            make_rule("dqn")(plan, QLearningSettings(), values, (4, 0), noise)
