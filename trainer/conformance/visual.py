"""Visual observations, for players that have a camera."""

import io
from typing import Any

import numpy as np
from PIL import Image

from trainer.conformance.suite import Conformance, NotApplicable, agents, expect

PNG = 1


class VisualObservations(Conformance):
    """Visual observations, for players that have a camera."""

    def test_a_compressed_observation_is_a_png_of_its_shape(self) -> None:
        seen = [each for each in self._visual() if each.compression_type == PNG]
        if not seen:
            raise NotApplicable("the player's visual observations are not compressed")
        for each in seen:
            with Image.open(io.BytesIO(each.compressed_data)) as image:
                size = {image.height, image.width}
            came = f"a {image.width} x {image.height} picture for shape {list(each.shape)}"
            expect(size <= set(each.shape), came, "a picture of this shape")

    def test_an_uncompressed_observation_holds_floats_from_0_to_1(self) -> None:
        seen = [each for each in self._visual() if each.compression_type != PNG]
        if not seen:
            raise NotApplicable("the player's visual observations are compressed")
        for each in seen:
            values = np.array(each.float_data.data)
            size, shape = int(np.prod(each.shape)), list(each.shape)
            expect(len(values) == size, f"shape {shape} with {len(values)} values", str(size))
            lowest, highest = values.min(), values.max()
            expect(0.0 <= lowest <= highest <= 1.0, f"values from {lowest} to {highest}", "one from 0 to 1 each")

    def test_the_picture_changes_when_agents_move(self) -> None:
        with self.playing() as session:
            first = [str(each) for info in agents(session.output) for each in info.observations if len(each.shape) == 3]
            if not first:
                raise NotApplicable("the player has no visual observation")
            for _ in range(20):
                session.step(1.0)
            now = [str(each) for info in agents(session.output) for each in info.observations if len(each.shape) == 3]
            expect(first != now, "the same picture after 20 steps", "another one")

    def _visual(self) -> list[Any]:
        with self.playing(num_areas=2) as session:
            seen = [each for info in agents(session.output) for each in info.observations if len(each.shape) == 3]
        if not seen:
            raise NotApplicable("the player has no visual observation")
        return seen
