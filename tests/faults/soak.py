"""Runs world, codec and exchange, or training, for very many steps, and watches memory, descriptors and threads.

python tests/faults/soak.py exchange --steps 100000000 --csv exchange.csv
python tests/faults/soak.py training --steps 10000000 --csv training.csv
python tests/faults/soak.py plot exchange.csv training.csv --png docs/soak.png
"""

import argparse
import csv
import os
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from harness import Run
from matplotlib.figure import Figure

COLUMNS = ["process", "seconds", "resident_bytes", "descriptors", "threads"]
SAMPLE_SECONDS = 0.5
BLOCKS = 20
T_OF_BLOCKS = 2.10  # 97.5% of Student's t with 18 degrees of freedom, of 19 changes


def sample(process: int) -> tuple[int, int, int]:
    """A process's resident bytes, open descriptors and threads."""
    pages = int(Path(f"/proc/{process}/statm").read_text().split()[1])
    descriptors = len(os.listdir(f"/proc/{process}/fd"))
    return pages * os.sysconf("SC_PAGE_SIZE"), descriptors, len(os.listdir(f"/proc/{process}/task"))


def slope(seconds: np.ndarray, values: np.ndarray) -> tuple[float, float]:
    """Bytes a second over the last half, and half the width of its 95% interval.

    Memory stays where its last step took it, so a line's residuals are not independent and its interval is too narrow:
    a single page would be a trend. The slope is the mean change from one of 20 blocks to the next instead.
    """
    late = seconds >= seconds[0] + (seconds[-1] - seconds[0]) / 2
    blocks = np.array_split(np.flatnonzero(late), BLOCKS)
    middles, means = (np.array([column[block].mean() for block in blocks]) for column in (seconds, values))
    changes = np.diff(means) / np.diff(middles)
    return float(changes.mean()), T_OF_BLOCKS * float(changes.std(ddof=1) / np.sqrt(len(changes)))


def exchange(steps: int, port: int) -> Iterator[list[float | str]]:
    """World, codec and exchange: 4,096 areas through ``UnityVecEnv``."""
    from mlagents_envs.side_channel.stats_side_channel import StatsSideChannel

    import trainer  # noqa: F401 - makes mlagents_envs importable
    from trainer.players.opening import open_environment
    from trainer.players.vec_env import UnityVecEnv

    areas = 4096
    with tempfile.TemporaryDirectory() as folder:
        environment = open_environment(
            "builtin",
            seed=0,
            num_areas=areas,
            port=port,
            timeout_wait=120,
            log_folder=Path(folder),
            side_channels=[statistics := StatsSideChannel()],
        )
        slots = UnityVecEnv(environment, statistics)
        slots.reset()
        generator, began, last = np.random.default_rng(0), time.monotonic(), 0.0
        actions = generator.uniform(-1, 1, (64, areas, 2)).astype(np.float32)
        for step in range(0, steps, areas):
            slots.step(actions[step // areas % 64])
            if (now := time.monotonic() - began) >= last + SAMPLE_SECONDS:
                last = now
                for name, process in (("trainer", os.getpid()), ("player", environment._process.pid)):
                    yield [name, now, *sample(process)]
        print(f"{steps:,} steps in {time.monotonic() - began:.0f} s")
        slots.close()


def training(steps: int, port: int) -> Iterator[list[float | str]]:
    """``corridor train``."""
    with tempfile.TemporaryDirectory() as folder:
        run = Run(Path(folder), "soak", port, "--steps", steps, "--timeout-wait", 120)
        process, began = run.start(), time.monotonic()
        run.wait_for_steps(process, 1)
        players = run.players()
        while process.poll() is None and run.steps() < steps:
            now = time.monotonic() - began
            try:
                yield ["trainer", now, *sample(process.pid)]
                yield ["player", now, *sample(players[0])]
            except (FileNotFoundError, ProcessLookupError):
                break
            time.sleep(SAMPLE_SECONDS)
        assert run.wait(process) == 0, run.output
        print(f"{steps:,} steps in {time.monotonic() - began:.0f} s")


def plot(files: list[Path], png: Path) -> None:
    """Memory over time, and each line's slope over its last half."""
    figure = Figure(figsize=(9, 3.2 * len(files)), layout="constrained")
    for axes, path in zip(figure.subplots(len(files), squeeze=False)[:, 0], files, strict=True):
        with path.open(newline="") as file:
            rows = list(csv.DictReader(file))
        for name in ("trainer", "player"):
            own = [row for row in rows if row["process"] == name]
            seconds, resident = (np.array([float(row[key]) for row in own]) for key in ("seconds", "resident_bytes"))
            rate, width = slope(seconds, resident)
            text = f"{name}: {rate / 1e3:+.2f} +- {width / 1e3:.2f} kB/s"
            axes.plot(seconds, resident / 2**20, label=text)
            counts = {key: sorted({int(row[key]) for row in own}) for key in ("descriptors", "threads")}
            print(path.stem, text, counts)
        axes.set(title=path.stem, xlabel="seconds", ylabel="resident memory (MiB)", ylim=(0, None))
        axes.legend(title="slope of the last half, 95% interval")
    figure.savefig(png, dpi=110)


def main() -> None:
    """Runs or draws a soak."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["exchange", "training", "plot"])
    parser.add_argument("files", nargs="*", type=Path)
    parser.add_argument("--steps", type=int, default=10_000_000)
    parser.add_argument("--base-port", type=int, default=6460)
    parser.add_argument("--csv", type=Path)
    parser.add_argument("--png", type=Path)
    options = parser.parse_args()
    if options.what == "plot":
        plot(options.files, options.png)
        return
    with options.csv.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        for row in {"exchange": exchange, "training": training}[options.what](options.steps, options.base_port):
            writer.writerow(row)
            file.flush()


if __name__ == "__main__":
    main()
