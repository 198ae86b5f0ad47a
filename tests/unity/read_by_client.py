"""Plays every scene of the stand-in through Unity's published client, whichever one this interpreter has.

Prints a line of JSON for each: what came of each agent, or the client's refusal. Arguments: the build, a port, a folder
for logs, and the scenes.
"""

import contextlib
import json
import sys

with contextlib.suppress(ImportError):
    import trainer  # noqa: F401 - makes mlagents_envs 0.28 importable

import numpy as np
from mlagents_envs.environment import UnityEnvironment
from mlagents_envs.side_channel.stats_side_channel import StatsSideChannel


def act(environment, generator):
    """Actions at random for everybody who asked, none of them masked."""
    for name in environment.behavior_specs:
        asking, _ = environment.get_steps(name)
        action = environment.behavior_specs[name].action_spec.empty_action(len(asking))
        action.continuous[:] = generator.uniform(-1, 1, action.continuous.shape)
        for branch, mask in enumerate(asking.action_mask or []):
            action.discrete[:, branch] = np.argmax(generator.random(mask.shape) * ~mask, axis=1)
        environment.set_actions(name, action)


def enter(environment, books):
    """Adds a message's agents to the books."""
    for name in environment.behavior_specs:
        asking, ended = environment.get_steps(name)
        for steps in (ended, asking):
            for place, number in enumerate(steps.agent_id):
                own = books.setdefault(int(number), {"decisions": 0, "reward": 0.0, "group_reward": 0.0, "ends": []})
                own["reward"] += float(steps.reward[place])
                own["group_reward"] += float(steps.group_reward[place])
                if steps is asking:
                    own["decisions"] += 1
                else:
                    own["ends"].append("interrupted" if steps.interrupted[place] else "terminated")


def play(build, port, folder, scene):
    generator, books = np.random.default_rng(0), {}
    environment = UnityEnvironment(
        file_name=build,
        base_port=port,
        seed=3,
        num_areas=2,
        log_folder=folder,
        side_channels=[StatsSideChannel()],
        additional_args=["--spec", scene, "-logFile", f"{folder}/{scene}.log"],
    )
    try:
        for number in range(150):
            if number in (0, 50):
                environment.reset()
            else:
                act(environment, generator)
                environment.step()
            enter(environment, books)
        return {"scene": scene, "behaviors": sorted(environment.behavior_specs), "books": books}
    except Exception as error:
        return {"scene": scene, "refusal": f"{type(error).__name__}: {error}"}
    finally:
        environment.close()


if __name__ == "__main__":
    build, port, folder, *scenes = sys.argv[1:]
    for place, scene in enumerate(scenes):
        print(json.dumps(play(build, int(port) + place, folder, scene)), flush=True)
