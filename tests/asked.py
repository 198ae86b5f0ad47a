"""``corridor train`` as tests ask for it: options by their names, in whichever group of the help they stand."""

from dataclasses import fields
from pathlib import Path
from typing import Any

from trainer.commands.train import EnvironmentOptions, LearningOptions, Train

GROUPS = {"environment": EnvironmentOptions, "training": LearningOptions}


def asked(run_id: str, file: Path | None = None, **options: Any) -> Train:
    groups = {}
    for group, kind in GROUPS.items():
        groups[group] = kind(**{each.name: options.pop(each.name) for each in fields(kind) if each.name in options})
    return Train(run_id, file, **groups, **options)
