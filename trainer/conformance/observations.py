"""What agents see: shapes, values, names."""

import numpy as np

from trainer.conformance.session import VARIABLE_SIZE, agents, all_finite
from trainer.conformance.suite import Conformance, needs
from trainer.conformance.verdicts import expect, expect_equal

NO_COMPRESSION = 0


class Observations(Conformance):
    """What agents see: shapes, values, names."""

    @needs("observations")
    def test_observations_have_as_many_values_as_their_shape_says(self) -> None:
        with self.playing(num_areas=2) as session:
            for output in session.play(50):
                for info in agents(output):
                    for each in info.observations:
                        shape = list(each.shape)
                        if each.compression_type == NO_COMPRESSION:
                            count, size = len(each.float_data.data), int(np.prod(shape))
                            expect(count == size, f"{each.name}: shape {shape} with {count} values", f"{size}")
                        else:
                            expect(each.compressed_data, f"{each.name}: no compressed data", "a picture")

    @needs("dimension properties")
    def test_dimension_properties_are_one_for_each_axis(self) -> None:
        with self.playing(num_areas=2) as session:
            for output in session.play(50):
                for info in agents(output):
                    for each in info.observations:
                        shape, count = list(each.shape), len(each.dimension_properties)
                        if count:
                            came = f"{each.name}: shape {shape} with {count} dimension properties"
                            expect(count == len(shape), came, "one for each axis")

    @needs("observation of variable size")
    def test_an_observation_of_variable_size_has_two_axes_of_which_the_first_varies(self) -> None:
        with self.playing(num_areas=2) as session:
            for output in session.play(50):
                for info in agents(output):
                    for each in info.observations:
                        if VARIABLE_SIZE in each.dimension_properties:
                            expect_equal(len(each.shape), 2, f"{each.name}: the number of axes is")
                            first = each.dimension_properties[0]
                            expect_equal(first, VARIABLE_SIZE, f"{each.name}: the first axis' property is")

    def test_observations_keep_their_names_and_shapes(self) -> None:
        with self.playing(num_areas=2) as session:
            kinds: dict[str, tuple[tuple[str, tuple[int, ...]], ...]] = {}
            for output in session.play(200):
                for behavior in output.rl_output.agentInfos:
                    for info in agents(output, behavior):
                        kind = tuple((each.name, tuple(each.shape)) for each in info.observations)
                        expected = kinds.setdefault(behavior, kind)
                        expect(kind == expected, f"{behavior}'s agent {info.id} sees {kind}", f"{expected}")

    def test_observations_and_rewards_are_finite(self) -> None:
        with self.playing(num_areas=2) as session:
            for output in session.play(100):
                for info in agents(output):
                    values = [value for each in info.observations for value in each.float_data.data]
                    finite = all_finite([info.reward, info.group_reward, *values])
                    expect(finite, f"agent {info.id} has NaN or Inf", "a finite number")
