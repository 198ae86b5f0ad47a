"""What an update is spent in: parts that add up, and products that are the real ones."""

import time

import numpy as np
import pytest

from trainer.bench.limit_parts import ELEMENTWISE, NETWORKS, OTHERS, PRODUCTS, PYTHON, limit_parts, split
from trainer.bench.limit_program import PartsClock, RecordedArray, products_alone, record
from trainer.bench.workload import Workload
from trainer.learning.networks import Network, joined


def test_parts_add_up_to_the_whole():
    found = split({"updates": 7, "seconds": {NETWORKS: 0.06, OTHERS: 0.01}, "products": 0.02, "calls": 0.015})
    assert found["parts"][PRODUCTS] == 0.02
    assert found["parts"][PYTHON] == 0.015
    assert found["parts"][ELEMENTWISE] == pytest.approx(0.025)
    assert sum(found["parts"].values()) == pytest.approx(found["update_seconds"]) == pytest.approx(0.07)
    assert found["networks_to_products"] == pytest.approx(3.0)


def test_of_what_is_inside_another_only_the_rest_of_the_other_counts_there():
    class Outer:
        def run(self):
            time.sleep(0.02)
            Inner().run()

    class Inner:
        def run(self):
            time.sleep(0.05)

    clock = PartsClock()
    clock.wrap(Outer, "run", "outer")
    clock.wrap(Inner, "run", "inner")
    begun = time.perf_counter()
    clock.restart()
    Outer().run()
    clock.look()
    whole = time.perf_counter() - begun
    assert clock.seconds["inner"] >= 0.05
    assert 0.02 <= clock.seconds["outer"] <= whole - 0.05
    assert sum(clock.seconds.values()) == pytest.approx(whole, abs=2e-3)


def test_every_product_of_a_network_is_written_down_and_changes_nothing():
    network = Network(5, 7, 3)
    adam = joined([network], np.random.default_rng(0))
    inputs, slope = np.ones((11, 5), np.float32), np.ones((11, 3), np.float32)

    def pass_through():
        given, outputs = network(inputs)
        network.differentiate(given, slope.copy())
        return outputs.copy(), adam.gradient.copy()

    plain = pass_through()
    RecordedArray.products.clear()
    RecordedArray.operands.clear()
    end = record([network])
    recorded = pass_through()
    end()
    assert type(recorded[0]) is np.ndarray
    for each, other in zip(plain, recorded, strict=True):
        np.testing.assert_array_equal(each, other)
    shapes = sorted(tuple(shape for shape, _ in key) for key in RecordedArray.products.elements())
    forward, back, gradients = [((11, 5), (5, 7)), ((11, 7), (7, 3))], [((11, 3), (3, 7))], [((3, 11), (11, 7))]
    assert shapes == sorted([*forward, *back, *gradients, ((7, 11), (11, 5))])
    assert 0 < products_alone() < 1
    pass_through()
    assert RecordedArray.products.total() == 5


@pytest.mark.slow
def test_a_run_is_split_whole(free_port):
    found = limit_parts(free_port, Workload(limit_updates=3))
    assert found["updates"] >= 3
    assert all(seconds > 0 for name, seconds in found["parts"].items() if name != ELEMENTWISE)
    assert sum(found["parts"].values()) == pytest.approx(found["update_seconds"])
    assert found["networks_to_products"] > 1
