"""``corridor bench --peers``: PPO on the corridor by this trainer and by others, in turns in one run.

Every row is measured in turn with this trainer in process, on as many cores, so that a ratio holds on a machine whose
speed drifts.
"""

import os
import shutil
import statistics
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import yaml

import trainer
from trainer.bench.learning_process import LearningProcess, MLAgentsProcess
from trainer.bench.our_player import player_path
from trainer.bench.peer_environments import Peer, importable, install, installed, same_torch
from trainer.bench.peers.peer_settings import PeerSettings
from trainer.bench.workload import Workload
from trainer.corridor import CORRIDOR
from trainer.errors import TrainerError
from trainer.presets import CURIOSITY_RATIO, PRESETS
from trainer.signals import temporary_folder

OURS = Peer("this trainer, in process", "our_program", "curious-corridor[trainer]")
EVERYONE = (
    OURS,
    Peer("in process, with curiosity", OURS.module, OURS.package, c=CURIOSITY_RATIO),
    Peer("this trainer, through gRPC", OURS.module, OURS.package, over_grpc=True),
    Peer("through gRPC, with curiosity", OURS.module, OURS.package, c=CURIOSITY_RATIO, over_grpc=True),
    Peer("Stable-Baselines3", "sb3_program", "stable-baselines3"),
    Peer("SBX (JAX)", "sbx_program", "sbx-rl", ("sbx-rl==0.28.0", same_torch())),
    Peer("one file of torch (CleanRL's way)", "torch_program", "torch"),
    Peer(
        "PufferLib",
        "puffer_program",
        "pufferlib",
        ("pufferlib==3.0.0", same_torch()),
        built_with=("setuptools", "wheel", "Cython", "numpy<2", same_torch()),
    ),
)
MLAGENTS = "mlagents-learn, through gRPC"
SUMMARY_STEPS = 2048  # of mlagents-learn, between two of its lines
FOR_EVER = 10**9
Start = Callable[[Sequence[int]], LearningProcess]


def beside_peers(
    official: str | None, port: int, workload: Workload, peers: Sequence[Peer] = EVERYONE
) -> Iterator[dict[str, Any]]:
    """Rows, each as soon as it is there.

    Args:
        official: An interpreter that has mlagents 1.1.0 beside it.
        port: The first of two.
        workload: How often and how long to measure.
        peers: Which; the first is the one that all are measured beside.

    Yields:
        ``name``, ``version``, ``install_mb`` and, by the number of ``cores``, ``steps_per_second``, ``to_ours`` (the
        part of this trainer's rate in process, which has a turn after each of theirs), ``cores_used`` and ``peak_mb``;
        or ``name`` and the ``problem``.

    Raises:
        TrainerError: This trainer itself can't be measured, or this system can't hold a process to a core.
    """
    if not hasattr(os, "sched_setaffinity"):
        raise TrainerError("--peers holds programs to one core, which this system can't do; run it on Linux.")
    available = sorted(os.sched_getaffinity(0))
    kinds = [available[:count] for count in (1, 2) if len(available) >= count]
    settings = peer_settings(workload.peer_areas)
    with ExitStack() as stack:
        variables = stack.enter_context(importable())
        folder = stack.enter_context(temporary_folder())

        ours_alone = {**os.environ, "PYTHONPATH": str(Path(trainer.__path__[0]).parent.absolute())}

        def start(peer: Peer) -> Start:
            python = install(peer)
            told = PeerSettings(**settings | {"c": peer.c, "port": port if peer.over_grpc else None})
            # Ours is the program that runs this; others are given no more of it than they need.
            own = ours_alone if peer.module == OURS.module else variables
            command = [python, "-m", f"trainer.bench.peers.{peer.module}", told.to_json()]
            return lambda cores: LearningProcess(peer.name, command, cores, own, folder)

        ours = [stack.enter_context(start(peers[0])(cores)) for cores in kinds]
        for peer in peers:
            try:
                begin = start(peer)
                found = installed(install(peer), peer.package, variables)
                measured = _measured(None if peer is peers[0] else begin, ours, kinds, workload)
                yield {"name": peer.name, **found, "cores": measured}
            except TrainerError as error:
                yield {"name": peer.name, "problem": str(error)}
        learn = None if official is None else _mlagents_learn(official)
        if learn is not None and official is not None:
            config = folder / "mlagents.yaml"
            config.write_text(yaml.safe_dump(mlagents_config(PeerSettings(**settings))))
            command = [learn, str(config), "--env", player_path(), "--num-areas", str(workload.peer_areas)]
            command += ["--no-graphics", "--base-port", str(port), "--results-dir", str(folder / "results"), "--force"]
            plain = {**variables, "PYTHONPATH": "", "PYTHONUNBUFFERED": "1"}
            try:
                found = installed(official, "mlagents", variables)
                measured = _measured(
                    lambda cores: MLAgentsProcess(MLAGENTS, command, cores, plain, folder), ours, kinds, workload
                )
                yield {"name": MLAGENTS, **found, "cores": measured}
            except TrainerError as error:
                yield {"name": MLAGENTS, "problem": str(error)}


def peer_settings(areas: int) -> dict[str, Any]:
    """What all are told: the corridor and PPO of the default preset."""
    ppo = PRESETS["fast"].ppo
    names = [name for name in PeerSettings.__dataclass_fields__ if hasattr(ppo, name)]
    return {"areas": areas, **{name: getattr(ppo, name) for name in names}, "corridor": CORRIDOR}


def mlagents_config(settings: PeerSettings) -> dict[str, Any]:
    """The same as near as mlagents-learn's settings come: its layers have another activation (swish)."""
    return {
        "behaviors": {
            "Corridor": {
                "trainer_type": "ppo",
                "hyperparameters": {
                    "batch_size": settings.batch_size,
                    "buffer_size": settings.rollout,
                    "learning_rate": settings.learning_rate,
                    "learning_rate_schedule": "constant",
                    "beta": settings.ent_coef,
                    "epsilon": settings.clip_range,
                    "lambd": settings.gae_lambda,
                    "num_epoch": settings.epochs,
                },
                "network_settings": {"normalize": True, "hidden_units": settings.hidden_size, "num_layers": 2},
                "reward_signals": {"extrinsic": {"gamma": settings.gamma, "strength": 1.0}},
                "time_horizon": settings.n_steps,
                "summary_freq": SUMMARY_STEPS,
                "max_steps": FOR_EVER,
                "checkpoint_interval": FOR_EVER,
            }
        },
        "environment_parameters": settings.corridor,
        "torch_settings": {"device": "cpu"},
    }


def _measured(
    start: Start | None, ours: Sequence[LearningProcess], kinds: Sequence[Sequence[int]], workload: Workload
) -> dict[str, dict[str, float]]:
    """Of a learner, or of ours itself where none is to be started, by the number of cores."""
    found = {}
    for reference, cores in zip(ours, kinds, strict=True):
        with _started(start, reference, cores) as learner:
            theirs, beside = [], []
            for _ in range(workload.rounds):
                theirs.append(learner.turn(workload.peer_seconds))
                beside.append(theirs[-1] if learner is reference else reference.turn(workload.peer_seconds))
                if theirs[-1].fault:
                    raise TrainerError(f"{learner.name} learned nothing: {theirs[-1].fault}.")
            parts = [each.rate / other.rate for each, other in zip(theirs, beside, strict=True)]
            found[str(len(cores))] = {
                "steps_per_second": statistics.median(each.rate for each in theirs),
                "to_ours": statistics.median(parts),
                "cores_used": statistics.median(each.cores for each in theirs),
                "peak_mb": learner.peak_megabytes(),
            }
    return found


@contextmanager
def _started(start: Start | None, reference: LearningProcess, cores: Sequence[int]) -> Iterator[LearningProcess]:
    if start is None:
        yield reference
        return
    with start(cores) as learner:
        yield learner


def _mlagents_learn(official: str) -> str | None:
    """The command beside an interpreter; None if it isn't there."""
    python = shutil.which(official)
    return None if python is None else shutil.which("mlagents-learn", path=str(Path(python).parent))
