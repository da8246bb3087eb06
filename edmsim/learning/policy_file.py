"""A trained policy as two files: ``NAME.json``, its description, and ``NAME.npz``, its network as plain arrays.

Neither has code, so reading a policy never runs code of its author.
"""

import hashlib
import io
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field, FiniteFloat, ValidationError

from edmsim import files, models, user_code
from edmsim.controllers import FeedController, SeesTruth, from_text, names
from edmsim.envs import part_task, registry
from edmsim.envs.task import KNOBS, EnvArguments, Family
from edmsim.errors import InputError, invalid_entry, located, one_of, refuses_wrong_types
from edmsim.learning import bandit

FORMAT = "edmsim-policy-1"
ACTION_MEANINGS = {
    "feed": "feed, or its change: see docs/environments.md", "target": "open share that the servo holds", **KNOBS,
    "offset": "offset from the path, left positive",
}
"""Meanings of the entries of an action, by name (`Family.action_names`)."""
_OF_PASSES = {name: meaning for name, (meaning, _) in part_task.ACTIONS.items()}  # for Part, whose actions set a pass
Floats = NDArray[np.float64]


class ObservedEntry(BaseModel, extra="forbid", frozen=True):
    """One entry of the observation."""

    # name, meaning: see `edmsim.envs.observation`
    name: str
    meaning: str
    # mean, variance: statistics for its normalisation
    mean: FiniteFloat
    variance: Annotated[FiniteFloat, Field(ge=0)]


class Residual(BaseModel, extra="forbid", frozen=True):
    """A classic law; the policy's first action is added to its feed."""

    law: str  # see `edmsim.controllers.from_text`
    range_um_s: Annotated[FiniteFloat, Field(gt=0)]  # change of the feed per action of 1, um/s

    def make(self) -> FeedController:
        """Return the law, which must be edmsim's: a policy file never runs other code.

        Raises
        ------
        InputError
            If the name is unknown, or the law observes what no machine measures.
        """
        known = self.law.partition(":")[0] in names() and user_code.named(self.law) is None
        law = from_text(self.law) if known else None
        if law is None or isinstance(law, SeesTruth):
            laws = one_of(self.law, (name for name in names() if not isinstance(from_text(name), SeesTruth)))
            raise InputError(
                f"a policy adds to a law of edmsim that a machine could have, not to '{self.law}'; there are: {laws}"
            )
        return law

    def check(self, family: EnvArguments) -> None:
        """Raise `InputError` if the law is unknown, or the environment's actions are not speeds of single windows."""
        self.make()
        if not isinstance(family, Family) or family.action != "speed" or family.decision_s is not None:
            raise InputError("a policy that adds to a law commands a speed every window; its environment does not")

    def action(self, family: Family, law_um_s: float, correction: float) -> np.float32:
        """Return the action for an environment with ``action="speed"``: the law's feed plus the correction."""
        added_um_s = min(max(float(correction), -1.0), 1.0) * self.range_um_s
        return np.float32(min(max((law_um_s + added_um_s) / family.max_feed_um_s, -1.0), 1.0))


class Card(BaseModel, extra="forbid", frozen=True):
    """Description of a policy: the contents of ``NAME.json``."""

    format: Literal["edmsim-policy-1"]  # `FORMAT`
    env_id: str  # environment of the training, or its present version
    environment: dict[str, Any]  # arguments of that environment
    # the network's inputs, in order: (entry - mean) / sqrt(variance + `epsilon`), clipped to -`clip`..`clip`
    observation: Annotated[list[ObservedEntry], Field(min_length=1)]
    epsilon: Annotated[FiniteFloat, Field(gt=0)]
    clip: Annotated[FiniteFloat, Field(gt=0)]
    # the network's outputs, in order; 1 and -1 are the ends of the action space
    action: Annotated[list[str], Field(min_length=1)]
    widths: list[Annotated[int, Field(gt=0)]]  # number of neurons of each hidden layer; may be empty
    activation: Literal["tanh", "relu"]  # activation of the hidden layers
    # number of cells of an LSTM before the hidden layers; by default no LSTM
    lstm: Annotated[int, Field(gt=0)] | None = None
    # law to whose feed the first action is added; by default the action is the environment's
    residual: Residual | None = None
    output: Literal["clip", "tanh"]  # function that limits the outputs to -1..1
    arrays_sha256: str  # hash of ``NAME.npz``
    algorithm: str
    command: str  # command of the training
    # environment version of the training, if it has been withdrawn since; by default `env_id`
    trained_in: str | None = None
    seed: int | None  # None if the learner had no seed
    steps: int
    versions: dict[str, str]
    # scores of the policy and of classic controllers; those of a user's environment name it as ``env_id``
    scores: list[dict[str, Any]] = []


class Lstm(NamedTuple):
    """Weights of an LSTM; columns are its gates input, forget, cell, output (Hochreiter and Schmidhuber 1997)."""

    input_weights: Floats  # (inputs, 4 cells)
    memory_weights: Floats  # (cells, 4 cells)
    bias: Floats  # (4 cells,)

    def after(self, observation: Floats, memory: Floats) -> Floats:
        """Return the memory (2, cells), output and cell state, after an observation (inputs,)."""
        gates = observation @ self.input_weights + memory[0] @ self.memory_weights + self.bias
        let_in, forget, cell, put_out = np.split(gates, 4)
        cells = _sigmoid(forget) * memory[1] + _sigmoid(let_in) * np.tanh(cell)
        return np.stack([_sigmoid(put_out) * np.tanh(cells), cells])


def _sigmoid(values: Floats) -> Floats:
    return np.asarray(0.5 * (1.0 + np.tanh(0.5 * values)))  # does not overflow


@dataclass(frozen=True)
class Policy:
    """A network that turns an observation into an action."""

    card: Card
    weights: tuple[Floats, ...]  # (inputs, outputs)
    biases: tuple[Floats, ...]  # (outputs,)
    lstm: Lstm | None = None  # LSTM before the layers; None if the policy has no LSTM

    def __repr__(self) -> str:
        """Return one line, because the network's numbers would fill pages of a notebook."""
        return f"<Policy of {self.card.env_id}: {self.card.algorithm}, {self.card.steps:,} steps>"

    @cached_property
    def _normal(self) -> tuple[Floats, Floats]:
        """Mean and scale of every entry."""
        entries = self.card.observation
        return np.array([e.mean for e in entries]), np.sqrt([e.variance + self.card.epsilon for e in entries])

    def fresh_memory(self) -> Floats:
        """Return the memory (2, cells) at the start of an episode; without an LSTM, `cells` is 0."""
        return np.zeros((2, self.card.lstm or 0))

    def action(self, observation: NDArray[Any]) -> Floats:
        """Return the action (k,) within -1..1 for an episode's first observation (n,); it is deterministic."""
        return self.act(observation, self.fresh_memory())[0]

    def act(self, observation: NDArray[Any], memory: Floats) -> tuple[Floats, Floats]:
        """Return the action (k,) within -1..1 for an observation (n,) of the environment, and the new memory.

        Parameters
        ----------
        observation : (n,)
        memory : float array (2, cells)
            Memory from the last call; `fresh_memory` at the start of an episode.
        """
        card = self.card
        mean, scale = self._normal
        layer: Floats = np.clip((observation - mean) / scale, -card.clip, card.clip)
        if self.lstm is not None:
            memory = self.lstm.after(layer, memory)
            layer = memory[0]
        last = len(self.weights) - 1
        for i, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            layer = layer @ weight + bias
            if i < last:
                layer = np.tanh(layer) if card.activation == "tanh" else np.maximum(layer, 0.0)
        return (np.tanh(layer) if card.output == "tanh" else np.clip(layer, -1.0, 1.0)), memory

    def arguments(self) -> EnvArguments:
        """Return the arguments of its environment that define the policy's observations and actions."""
        return registry.of_policy(self.card.env_id, self.card.environment)

    def family(self) -> Family:
        """Return the same for an environment of windows; raises `InputError` for Part."""
        return registry.of_windows(self.card.env_id, self.arguments())


def meanings(family: EnvArguments) -> list[str]:
    """Return the meanings of the entries of an environment's actions."""
    of_actions = ACTION_MEANINGS if isinstance(family, Family) else _OF_PASSES
    return [of_actions[name] for name in family.action_names]


def pack(weights: list[Floats], biases: list[Floats], lstm: Lstm | None = None) -> bytes:
    """Return the contents of ``NAME.npz``: float32 arrays ``weight_0, bias_0, weight_1`` and so on, and an LSTM's."""
    arrays = {} if lstm is None else {f"lstm_{k}": v.astype(np.float32) for k, v in lstm._asdict().items()}
    for i, (weight, bias) in enumerate(zip(weights, biases, strict=True)):
        arrays[f"weight_{i}"], arrays[f"bias_{i}"] = weight.astype(np.float32), bias.astype(np.float32)
    packed = io.BytesIO()
    np.savez(packed, allow_pickle=False, **arrays)
    return packed.getvalue()


def digest(packed: bytes) -> str:
    """Return the value for `Card.arrays_sha256`."""
    return hashlib.sha256(packed).hexdigest()


def write(card: Card, packed: bytes, file: Path) -> None:
    """Write both files; `file` is the ``.json``."""
    with files.replacing(file) as described, files.replacing(file.with_suffix(".npz")) as arrays:
        arrays.write_bytes(packed)
        described.write_text(card.model_dump_json(indent=1) + "\n", encoding="utf-8")


def write_policy(
    file: Path, *, env_id: str, environment: dict[str, Any], mean: Floats, variance: Floats,
    lstm: tuple[Floats, Floats, Floats] | None, weights: list[Floats], biases: list[Floats], algorithm: str,
    command: str, seed: int, steps: int, activation: Literal["tanh", "relu"] = "tanh", clip: float = 10.0,
) -> Policy:
    """Write the policy of a learner of your own; return the policy, read from the new files.

    Parameters
    ----------
    file : Path
        ``NAME.json``; ``NAME.npz`` goes into the same folder.
    env_id, environment
        Environment that defines the observations and the times of decisions, and its arguments.
    mean, variance : (entries,)
        Statistics of the environment's entries.
    lstm : tuple of arrays or None
        See `Lstm`.
    weights, biases : list of arrays
        Of the layers after it; the last outputs are the environment's actions, each -1 to 1.
    algorithm, command, seed, steps, activation, clip
        See `Card`. The default of `clip` is that of stable-baselines3's ``VecNormalize``. Gymnasium's
        ``NormalizeObservation`` does not clip; after a training with it give a large number, such as 1e9.

    Raises
    ------
    InputError
        If the parts do not fit each other.
    """
    memory = None if lstm is None else Lstm(*lstm)
    packed = pack(weights, biases, memory)
    card = card_of(
        env_id, environment, packed, mean, variance, epsilon=1e-8, clip=clip, activation=activation, output="clip",
        widths=[len(bias) for bias in biases[:-1]], lstm=None if memory is None else memory.memory_weights.shape[0],
        algorithm=algorithm, command=command, seed=seed, steps=steps,
        versions={name: version(name) for name in ("edmsim", "numpy")},
    )
    write(card, packed, file)
    return load(str(file))


def card_of(
    env_id: str, environment: dict[str, Any], packed: bytes, mean: Sequence[float] | Floats,
    variance: Sequence[float] | Floats, **more: Any,
) -> Card:
    """Return the card of packed arrays, mean and variance of the environment's entries, and `more` of `Card`."""
    family = registry.of_policy(env_id, environment)
    observation = [
        {"name": entry.name, "meaning": entry.meaning, "mean": float(m), "variance": float(v)}
        for entry, m, v in zip(family.entries(), mean, variance, strict=True)
    ]
    return Card.model_validate({
        "format": FORMAT, "env_id": env_id, "environment": environment, "observation": observation,
        "action": meanings(family), "arrays_sha256": digest(packed), **more,
    })


_NO_FILE = "no such file: a policy is a .json and the .npz next to it"


def locate(name: str) -> Path:
    """Return the ``.json`` file of a policy from its path or its name under ``models/policies``."""
    name = user_code.policy_of(name)
    file = Path(name)
    if file.suffix not in (".json", ".npz"):
        if name not in models.policies():
            known = one_of(name, models.policies())
            raise InputError(f"there is no policy '{name}'; give its .json file, or one of {known}")
        return models.path(f"policies/{name}.json")
    file = file.with_suffix(".json")
    if not file.is_file():
        raise InputError(_NO_FILE, file)
    return file


@refuses_wrong_types
def load(name: str, env_id: str | None = None) -> Policy:
    """Read a policy.

    Parameters
    ----------
    name : str
        Either of its files, or a name under ``models/policies``; the prefix ``policy:`` is optional.
    env_id : str, optional
        Environment of its training; by default any of edmsim's.

    Raises
    ------
    InputError
        If the policy is not found, is damaged, or belongs to another environment.
    """
    file = locate(name)
    try:
        card = Card.model_validate_json(file.read_bytes())
    except OSError as error:
        raise InputError(f"the policy cannot be read: {error.strerror}", file) from None
    except ValidationError as error:
        if bandit.find(name) is not None:
            networks = ", ".join(each for each in models.policies() if bandit.find(each) is None)
            reason = f"this policy chooses settings of a law and has no network: give one that has, as {networks}"
        else:
            reason = f"this is not a policy, or a damaged one: {invalid_entry(error)}"
        raise InputError(reason, file) from None
    if env_id is not None and card.env_id != env_id:
        raise InputError(f"the policy was trained in {card.env_id}, not in {env_id}", file)
    _check_environment(card, file)
    weights, biases, lstm = _unpack(card, file.with_suffix(".npz"))
    return Policy(card, weights, biases, lstm)


def _check_environment(card: Card, file: Path) -> None:
    """Raise `InputError` if the policy's inputs and outputs are not those of its environment."""
    try:
        family = registry.of_policy(card.env_id, card.environment)
    except (InputError, TypeError, ValueError) as error:
        raise InputError(f"the policy's environment cannot be made: {error}", file) from None
    expected = [entry.name for entry in family.entries()]
    found = [entry.name for entry in card.observation]
    if found != expected:
        raise InputError(
            f"the policy sees {len(found)} entries that are not the {len(expected)} of {card.env_id}: it was trained "
            "in another version of it", file,
        )
    if card.residual is not None:
        with located(file):
            card.residual.check(family)
    commands = meanings(family)
    if card.action != commands:
        raise InputError(
            f"the policy commands {', '.join(card.action)}; {card.env_id} takes {', '.join(commands)}: it was "
            "trained in another version of it", file,
        )


def _unpack(card: Card, file: Path) -> tuple[tuple[Floats, ...], tuple[Floats, ...], Lstm | None]:
    """Return weights, biases and LSTM, checked against the card."""
    layers = list(pairwise([card.lstm or len(card.observation), *card.widths, len(card.action)]))
    shapes: dict[str, tuple[int, ...]] = {}
    for i, (inputs, outputs) in enumerate(layers):
        shapes |= {f"weight_{i}": (inputs, outputs), f"bias_{i}": (outputs,)}
    if card.lstm is not None:
        four = 4 * card.lstm
        shapes |= {"lstm_input_weights": (len(card.observation), four), "lstm_memory_weights": (card.lstm, four),
                   "lstm_bias": (four,)}  # fmt: skip
    try:
        packed = file.read_bytes()
        if digest(packed) != card.arrays_sha256:
            raise ValueError("its sha256 is not that of the .json")
        stored = files.read_arrays(packed)
        found = {name: _plain(stored[name]) for name in shapes}
    except FileNotFoundError:
        raise InputError(_NO_FILE, file) from None
    except (OSError, ValueError, LookupError) as error:
        raise InputError(f"the policy's arrays are damaged: {error}", file) from None
    for name, shape in shapes.items():
        if found[name].shape != shape or not np.isfinite(found[name]).all():
            raise InputError(f"the policy's {name}, {found[name].shape}, is not {shape} finite numbers", file)
    weights, biases = (tuple(found[f"{kind}_{i}"] for i in range(len(layers))) for kind in ("weight", "bias"))
    return weights, biases, Lstm(*(found[f"lstm_{name}"] for name in Lstm._fields)) if card.lstm else None


def _plain(array: NDArray[Any]) -> Floats:
    """Return an array of floats as float64; raise `ValueError` for other types."""
    if array.dtype.kind != "f":
        raise ValueError(f"an array of {array.dtype} in place of floats")
    return array.astype(np.float64)
