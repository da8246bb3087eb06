"""A learner of a population, as Ray Tune runs it on some computer of a cluster (extras ``cluster`` and ``rl``)."""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ray import tune

from edmsim.learning.hyperparameters import Hyperparameters
from edmsim.sweep.tune import judge_policy

WHOSE = "learner.json"  # file of a checkpoint that says whose it is


class Learner(tune.Trainable):  # type: ignore[misc]
    """Trains on from its own checkpoint, or from another learner's, with the settings it has now."""

    def setup(self, config: dict[str, Any]) -> None:
        """Begin with nothing learnt."""
        self._folder = tempfile.TemporaryDirectory()
        self.reset_config(config)

    def reset_config(self, new_config: dict[str, Any]) -> bool:
        """Become another learner, which a checkpoint may follow."""
        self.config = new_config
        self._last: Path | None = None
        self._parent = self._number
        return True

    @property
    def _number(self) -> int:
        return int(self.trial_id.rpartition("_")[2])

    def step(self) -> dict[str, Any]:
        """Train for a generation, and judge the policy."""
        from edmsim.learning.train import train

        plan = self.config["plan"]
        usual = Hyperparameters.model_validate(plan["parameters"])
        values = {key: value for key, value in self.config.items() if key != "plan"}
        parameters = usual.model_copy(update={"algorithm": {**usual.algorithm, **values}})
        out = Path(tempfile.mkdtemp(dir=self._folder.name))
        done = 0 if self._last is None else json.loads((self._last / "run.json").read_text(encoding="utf-8"))["done"]
        trained = train(
            plan["env_id"], plan["algo"], out, steps=done + plan["windows"], seed=plan["seed"] + self._number,
            parameters=parameters, begin_from=self._last,
        )  # fmt: skip
        command = f"edmsim tune population {plan['env_id']} --algo {plan['algo']} --learners {plan['population']}"
        score = judge_policy(trained, command, out, plan["seeds"])
        (self._last,) = out.glob("checkpoint-*")
        (out / WHOSE).write_text(json.dumps(self._number), encoding="utf-8")
        for file in (*out.glob("policy.*"), out / WHOSE):
            shutil.move(file, self._last / file.name)
        parent, self._parent = self._parent, self._number
        return {"score": score, "windows": trained.model.num_timesteps, "learner": self._number, "parent": parent}

    def save_checkpoint(self, checkpoint_dir: str) -> None:
        """Hand over the last checkpoint, with the policy."""
        assert self._last is not None
        shutil.copytree(self._last, checkpoint_dir, dirs_exist_ok=True)

    def load_checkpoint(self, checkpoint: Any) -> None:
        """Take one, of whomever it is."""
        self._last = Path(tempfile.mkdtemp(dir=self._folder.name)) / "checkpoint"
        shutil.copytree(checkpoint, self._last)
        self._parent = int(json.loads((self._last / WHOSE).read_text(encoding="utf-8")))

    def cleanup(self) -> None:
        """Leave no file behind."""
        self._folder.cleanup()


class Watching(tune.Callback):  # type: ignore[misc]
    """Tells the driver of every generation of a learner."""

    watch: Callable[[dict[str, Any]], object] = staticmethod(lambda _: None)

    def on_trial_result(
        self, iteration: int, trials: list[Any], trial: Any, result: dict[str, Any], **info: Any
    ) -> None:
        """Take a result."""
        Watching.watch(result)
