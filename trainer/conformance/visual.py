"""Visual observations, for players that have a camera."""

import io
from typing import Any

import numpy as np
from PIL import Image

from corridor_server.protocol.messages import PNG
from trainer.conformance.session import Session, agents, pictures
from trainer.conformance.suite import Conformance, strict
from trainer.conformance.verdicts import NotApplicable, expect, expect_equal


class VisualObservations(Conformance):
    """Visual observations, for players that have a camera."""

    def test_a_compressed_observation_is_made_of_pngs_of_its_height_and_width(self) -> None:
        for each in self._compressed():
            shape = list(each.shape)
            files = pictures(each.compressed_data)
            expect(files, f"shape {shape} without a PNG file", "at least one")
            for file in files:
                with Image.open(io.BytesIO(file)) as image:
                    image.load()
                    size = [image.height, image.width]
                came = f"a picture of height {size[0]} and width {size[1]} for shape {shape}"
                expect(size in (shape[1:], shape[:2]), came, "one of the shape's")

    def test_a_compressed_observations_channels_are_those_of_its_pngs(self) -> None:
        for each in self._compressed():
            shape, count = list(each.shape), len(pictures(each.compressed_data))
            if each.compressed_channel_mapping:
                mapping = list(each.compressed_channel_mapping)
                expect_equal(len(mapping), 3 * count, f"{count} PNG files, and the length of the channel mapping is")
                channels = {channel for channel in mapping if channel >= 0}
                came = f"channel mapping {mapping} for shape {shape}"
                known = [set(range(size)) for size in (shape[0], shape[2])]
                expect(channels in known, came, "one for every channel of the shape")
            else:
                needed = {-(-size // 3) for size in (shape[0], shape[2])}
                expect(count in needed, f"{count} PNG files for shape {shape}", "one for every 3 channels")

    @strict
    def test_an_uncompressed_observation_holds_floats_from_0_to_1(self) -> None:
        seen = [each for each in self._visual() if each.compression_type != PNG]
        if not seen:
            raise NotApplicable("the player's visual observations are compressed")
        for each in seen:
            values = np.array(each.float_data.data)
            lowest, highest = values.min(), values.max()
            expect(0.0 <= lowest <= highest <= 1.0, f"values from {lowest} to {highest}", "one from 0 to 1 each")

    @strict
    def test_the_picture_changes_when_agents_move(self) -> None:
        with self.playing() as session:
            first = _of_last_message(session)
            if not first:
                raise NotApplicable("the player has no visual observation")
            for _ in range(20):
                session.step(1.0)
            changed = [str(each) for each in first] != [str(each) for each in _of_last_message(session)]
            expect(changed, "the same picture after 20 steps", "another one")

    def _compressed(self) -> list[Any]:
        seen = [each for each in self._visual() if each.compression_type == PNG]
        if not seen:
            raise NotApplicable("the player's visual observations are not compressed")
        return seen

    def _visual(self) -> list[Any]:
        with self.playing(num_areas=2) as session:
            seen = [each for _ in session.play(20) for each in _of_last_message(session)]
        if not seen:
            raise NotApplicable("the player has no visual observation")
        return seen


def _of_last_message(session: Session) -> list[Any]:
    return [each for info in agents(session.output) for each in info.observations if len(each.shape) == 3]
