"""Every kind of observation becomes features: what must not matter to them doesn't, and what doesn't fit is refused."""

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium import spaces
from stable_baselines3 import PPO

from corridor_server.protocol.agents import Behavior, Sensor
from trainer.errors import TrainerError
from trainer.learning.observation_encoder import EMBEDDING, ObservationEncoder, observation_space
from trainer.learning.picture_encoder import PictureEncoder, channel_axis

GOAL = Sensor("goal", (3,), (1,), 1)
VECTOR, BUFFER = Sensor.of("vector", (4,)), Sensor.of("buffer", (6, 5))
LIMITS = {"simple": 1, "nature_cnn": 36, "resnet": 15, "match3": 5, "fully_connected": 1}


@pytest.fixture(autouse=True)
def one_thread() -> None:
    torch.set_num_threads(1)  # as in training; more wait for each other where cores are shared


def encoder(*sensors: Sensor, seed: int = 1, **options) -> ObservationEncoder:
    torch.manual_seed(seed)
    return ObservationEncoder(observation_space(Behavior("any", sensors)), sensors, **options)


def test_vectors_are_joined_as_they_are():
    built = encoder(VECTOR, Sensor.of("other", (2,)))
    first, second = torch.rand(3, 4), torch.rand(3, 2)
    assert built.features_dim == 6
    assert torch.equal(built({"obs_0": first, "obs_1": second}), torch.cat((first, second), dim=1))


@pytest.mark.parametrize(
    "sensor",
    [
        Sensor("table", (3, 2), (1, 1)),
        Sensor("untold", (3, 2), ()),
        Sensor("volume", (3, 2, 1), (1, 1, 1)),
        Sensor("more", (1, 3, 2, 1), (1, 2, 2, 1)),
    ],
)
def test_numbers_of_any_other_shape_are_one_row(sensor):
    numbers = torch.rand(5, *sensor.shape)
    assert torch.equal(encoder(sensor).encode([numbers]), numbers.reshape(5, 6))


@pytest.mark.parametrize("sides", [(84, 84, 3), (36, 36, 1), (20, 20, 5), (10, 10, 4), (7, 7, 3), (3, 20, 2)])
@pytest.mark.parametrize("kind", LIMITS)
def test_a_picture_has_features_wherever_its_network_fits(sides, kind):
    picture = Sensor.of("camera", sides)
    if min(sides[:2]) < LIMITS[kind]:
        with pytest.raises(TrainerError, match=rf"camera has {sides[0]} x {sides[1]} pixels, but .* {kind} takes"):
            encoder(picture, vis_encode_type=kind)
        return
    built = encoder(picture, hidden_units=16, vis_encode_type=kind)
    features = built.encode([torch.rand(2, *sides)])
    assert features.shape == (2, built.features_dim) == (2, 16)
    features.square().sum().backward()
    assert all(each.grad is not None and each.grad.isfinite().all() for each in built.parameters())


@pytest.mark.parametrize(("kind", "limit"), LIMITS.items())
def test_the_smallest_picture_that_a_network_takes_is_ml_agents(kind, limit):
    smallest = encoder(Sensor.of("camera", (limit, limit + 9, 1)), vis_encode_type=kind)
    assert smallest.encode([torch.rand(2, limit, limit + 9, 1)]).isfinite().all()
    if limit > 1:
        with pytest.raises(TrainerError, match=f"from {limit} x {limit} on; choose simple"):
            encoder(Sensor.of("camera", (limit + 9, limit - 1, 1)), vis_encode_type=kind)


@pytest.mark.parametrize("kind", LIMITS)
def test_where_the_channels_stand_does_not_matter(kind):
    last, first = Sensor("camera", (40, 36, 3), (2, 2, 1)), Sensor("camera", (3, 40, 36), (1, 2, 2))
    silent = Sensor("camera", (40, 36, 3), ())
    picture = torch.rand(2, 40, 36, 3)
    expected = encoder(last, vis_encode_type=kind).encode([picture])
    found = encoder(first, vis_encode_type=kind).encode([picture.permute(0, 3, 1, 2).contiguous()])
    torch.testing.assert_close(found, expected)
    assert torch.equal(encoder(silent, vis_encode_type=kind).encode([picture]), expected)
    turned = encoder(last, vis_encode_type=kind).encode([picture.transpose(1, 2).reshape(2, 40, 36, 3)])
    assert not torch.allclose(turned, expected)


def test_which_axis_has_the_channels_is_read_off_the_properties():
    assert channel_axis(Sensor("camera", (3, 8, 8), (1, 2, 2))) == 0
    assert channel_axis(Sensor("camera", (8, 8, 3), (2, 2, 1))) == 2
    assert channel_axis(Sensor("camera", (8, 8, 3), (0, 0, 0))) == 2
    assert channel_axis(VECTOR) is channel_axis(BUFFER) is None


def test_simple_has_ml_agents_layers_where_they_fit():
    def kernels(side: int) -> list[tuple[int, tuple[int, ...]]]:
        layers = PictureEncoder(Sensor.of("camera", (side, side, 3)), 8, "simple").layers
        return [(each.out_channels, each.kernel_size) for each in layers if isinstance(each, torch.nn.Conv2d)]

    assert kernels(20) == [(16, (8, 8)), (32, (4, 4))]
    assert kernels(19) == kernels(5) == [(16, (3, 3)), (32, (3, 3))]
    assert kernels(4) == []


@pytest.fixture
def buffers() -> torch.Tensor:
    numbers = torch.randn(4, 6, 5)
    numbers[0, 4:] = numbers[1, 1:] = numbers[2] = 0.0
    return numbers


@pytest.mark.parametrize("sensors", [(BUFFER,), (BUFFER, VECTOR), (BUFFER, Sensor.of("camera", (8, 8, 1)))])
def test_entities_have_no_order_and_padding_no_part(buffers, sensors):
    rest = [torch.rand(4, *sensor.shape) for sensor in sensors[1:]]
    expected = encoder(*sensors).encode([buffers, *rest])
    shuffled = buffers[:, torch.randperm(6)]
    torch.testing.assert_close(encoder(*sensors).encode([shuffled, *rest]), expected)
    longer = (Sensor.of("buffer", (9, 5)), *sensors[1:])
    padded = torch.cat((torch.zeros(4, 3, 5), buffers), dim=1)
    torch.testing.assert_close(encoder(*longer).encode([padded, *rest]), expected)
    others = encoder(*sensors).encode([buffers + buffers.ne(0) * 0.5, *rest])
    changed = (others - expected).abs().amax(dim=1) > 1e-3
    assert changed.tolist() == [True, True, False, True]


def test_a_buffer_of_padding_alone_gives_zeros_and_finite_gradients(buffers):
    built = encoder(BUFFER)
    features = built.encode([buffers])
    assert features.shape == (4, EMBEDDING)
    assert not features[2].any()
    assert features[[0, 1, 3]].abs().sum(dim=1).all()
    features.square().sum().backward()
    assert all(each.grad is not None and each.grad.isfinite().all() for each in built.parameters())


def test_an_entity_is_seen_with_the_other_entities_and_with_the_agent_itself(buffers):
    built = encoder(BUFFER, VECTOR)
    itself = torch.rand(4, 4)
    entities = built.encode([buffers, itself])[:, 4:]
    assert not torch.allclose(built.encode([buffers, itself + 1.0])[:, 4:], entities)
    alone, pair, both = torch.zeros(1, 6, 5), torch.zeros(1, 6, 5), torch.zeros(1, 6, 5)
    alone[0, 0], pair[0, 0] = buffers[3, 0], buffers[3, 1]
    both[0, :2] = buffers[3, :2]
    separately = (built.encode([alone, itself[:1]]) + built.encode([pair, itself[:1]])) / 2
    assert not torch.allclose(built.encode([both, itself[:1]]), separately, atol=1e-4)


def test_goals_are_joined_to_the_rest_or_condition_it():
    vector, goal = torch.rand(3, 4), torch.eye(3)
    joined = encoder(VECTOR, GOAL, goal_conditioning_type="none")
    assert torch.equal(joined.encode([vector, goal]), torch.cat((vector, goal), dim=1))
    conditioned = encoder(VECTOR, GOAL, hidden_units=32)
    assert conditioned.features_dim == 32
    assert conditioned.encode([vector, goal]).shape == (3, 32)
    # How the features answer to the vector depends on the goal, even where nothing but the conditioning sees the goal.
    with torch.no_grad():
        conditioned.conditioned[0].weight[:, 4:] = 0.0
    slopes = [
        conditioned.encode([vector, row.expand(3, 3)]) - conditioned.encode([vector + 1, row.expand(3, 3)])
        for row in goal
    ]
    assert (slopes[0] / slopes[1] - 1.0).abs().mean() > 0.1


def test_the_space_names_observations_by_their_place_and_adds_masks():
    behavior = Behavior("any", (VECTOR, Sensor.of("camera", (8, 6, 3)), BUFFER), 2, (3, 2))
    space = observation_space(behavior)
    assert {name: each.shape for name, each in space.items()} == {
        "action_masks": (5,),
        "obs_0": (4,),
        "obs_1": (8, 6, 3),
        "obs_2": (6, 5),
    }
    assert all(each.dtype == np.float32 for each in space.values())
    assert "action_masks" not in observation_space(Behavior("any", (VECTOR,), 2)).spaces


def test_stable_baselines3_learns_with_it():
    sensors = (VECTOR, Sensor.of("camera", (8, 6, 3)), BUFFER, GOAL)
    space = observation_space(Behavior("any", sensors, 2))

    class Sampled(gymnasium.Env):
        observation_space, action_space = space, spaces.Box(-1, 1, (2,), np.float32)

        def reset(self, *, seed=None, options=None):
            super().reset(seed=seed)
            return self.observation_space.sample(), {}

        def step(self, action):
            return self.observation_space.sample(), float(action[0]), False, False, {}

    extractor = {"features_extractor_class": ObservationEncoder, "features_extractor_kwargs": {"sensors": sensors}}
    model = PPO("MultiInputPolicy", Sampled(), n_steps=16, batch_size=8, policy_kwargs=extractor, seed=1)
    before = model.policy.features_extractor.conditioning.weight.detach().clone()
    model.learn(16)
    assert not torch.equal(model.policy.features_extractor.conditioning.weight, before)


@pytest.mark.parametrize("sensors", [(), (Sensor.of("nothing", (0,)),)])
def test_agents_that_observe_nothing_are_refused(sensors):
    with pytest.raises(TrainerError, match="observe nothing, but at least one number was expected"):
        ObservationEncoder(observation_space(Behavior("Blind?team=0", sensors)), sensors)
