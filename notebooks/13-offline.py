# ---
# jupyter:
#   edmsim:
#     small: {steps: 600, epochs: 1, machines: 2}
#   jupytext:
#     formats: ipynb,py:percent
#     notebook_metadata_filter: edmsim,kernelspec,jupytext,-all
#     cell_metadata_filter: tags,-all
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Learning from records alone
#
# **Question.** How good is a feed controller that is learned only from records of other controllers?
#
# **What is done.** Three laws cut on machines drawn for `edmsim/GapFeed-v2`, and every window is stored in a
# [Minari](https://minari.farama.org) data set, as by `edmsim dataset`. Two networks learn from the same records:
# one imitates all actions (behaviour cloning), the other gives more weight to actions that earned more
# (advantage-weighted regression, Peng et al. 2019, [arXiv:1910.00177](https://arxiv.org/abs/1910.00177)). Both are
# then evaluated on other machines. This notebook needs the extras: `pip install "edmsim[rl,offline]"`.

# %% tags=["parameters"]
steps = 24_000  # windows recorded of each controller
epochs = 12  # passes over the records
machines = 8  # held-back machines that the policies are measured on
seed = 1  # of the networks

# %%
import os
import platform
import shutil
import tempfile
from importlib.metadata import version
from pathlib import Path

import matplotlib.pyplot as plt
import minari
import numpy as np
import torch
from IPython.display import Markdown

from edmsim.envs.registry import make_family
from edmsim.evaluation.compare import evaluate, markdown_table
from edmsim.learning import policy_file
from edmsim.learning.dataset import record
from edmsim.recording.figures.palette import BLUE, ORANGE, VERMILION

plt.rcParams.update({"figure.dpi": 90, "axes.spines.top": False, "axes.spines.right": False, "font.size": 9})
ENV = "edmsim/GapFeed-v2"
SETTING = {"action": "speed", "decision_s": None}  # as data sets have it: the feed, every window
folder = tempfile.TemporaryDirectory()
os.chdir(folder.name)  # all files go where they are thrown away
torch.manual_seed(seed)
torch.set_num_threads(1);  # more only wait for each other

# %% [markdown]
# ## The records
#
# In a shell the command is `edmsim dataset edmsim/GapFeed-v2 --controllers fixed,counts,voltage --steps 24000 --out
# records`. A broken wire ends an episode, and costs the time of threading another.

# %%
shutil.rmtree("records", ignore_errors=True)  # of an earlier run of this cell
recorded = record(ENV, ["fixed", "counts", "voltage"], steps, Path("records"))
os.environ["MINARI_DATASETS_PATH"] = str(Path("records").resolve())
sets = {one.dataset_id: minari.load_dataset(one.dataset_id) for one in recorded}
for one in recorded:
    print(f"{one.dataset_id:32} {one.episodes:3} episodes, {one.breaks} of them with a broken wire, "
          f"{one.steps:6} windows, mean return {one.mean_return:6.1f}")

# %% [markdown]
# The effect of an action appears later: a feed that is too high leads to a short, and a short to a jam. So every
# window is judged by the sum of discounted rewards that follow. The advantage is this sum less its expectation from
# the observation, which a second network learns.

# %%
DISCOUNT = 0.98  # looks some 50 windows ahead
returns_kept = {}


def following(rewards: np.ndarray) -> np.ndarray:
    """Discounted rewards from every step of an episode on."""
    sums, later = np.empty(len(rewards)), 0.0
    for k in range(len(rewards) - 1, -1, -1):
        sums[k] = later = rewards[k] + DISCOUNT * later
    return sums


seen, done, earned = [], [], []
for name, data in sets.items():
    episodes = list(data.iterate_episodes())
    seen += [episode.observations[:-1] for episode in episodes]
    done += [episode.actions for episode in episodes]
    earned += [following(episode.rewards) for episode in episodes]
    returns_kept[name] = [episode.rewards.sum() for episode in episodes]
seen, done, earned = (np.concatenate(parts).astype(np.float32) for parts in (seen, done, earned))
mean, variance = seen.mean(0, dtype=np.float64), seen.var(0, dtype=np.float64)
EPSILON, CLIP = 1e-4, 10.0
inputs = torch.tensor(np.clip((seen - mean) / np.sqrt(variance + EPSILON), -CLIP, CLIP), dtype=torch.float32)
actions = torch.tensor(done)
worth = torch.tensor((earned - earned.mean()) / earned.std())
print(f"{len(inputs)} windows, {inputs.shape[1]} entries each")

# %% [markdown]
# ## Two ways to learn

# %%
WIDTHS = [64, 64]
TEMPERATURE, MOST_WEIGHT = 1.0, 20.0  # of the advantages, in standard deviations of what windows earned


def network(outputs: int) -> torch.nn.Sequential:
    """Two hidden layers, as the shipped policies have them."""
    sizes = [inputs.shape[1], *WIDTHS]
    hidden = [part for pair in zip(sizes, WIDTHS, strict=False) for part in (torch.nn.Linear(*pair), torch.nn.Tanh())]
    return torch.nn.Sequential(*hidden, torch.nn.Linear(WIDTHS[-1], outputs))


def fit(wanted: torch.Tensor, weights: torch.Tensor) -> torch.nn.Sequential:
    """Least squares by Adam."""
    net = network(wanted.shape[1])
    adam = torch.optim.Adam(net.parameters(), 1e-3)
    for _ in range(epochs):
        for batch in torch.randperm(len(inputs)).split(512):
            error = ((net(inputs[batch]) - wanted[batch]) ** 2).sum(1)
            adam.zero_grad()
            (weights[batch] * error).mean().backward()
            adam.step()
    return net


even = torch.ones(len(inputs))
value = fit(worth[:, None], even)
with torch.no_grad():
    advantage = worth - value(inputs)[:, 0]
weights = torch.exp(advantage / TEMPERATURE).clamp(max=MOST_WEIGHT)
policies = {"cloned": fit(actions, even), "weighted": fit(actions, weights / weights.mean())}
share = 1.0 - float(advantage.var() / worth.var())
print(f"the observation alone explains {share:.0%} of what a window earned")

# %% [markdown]
# Saved as a policy of edmsim, a network works like any controller in `edmsim evaluate` and `edmsim cut`.

# %%
family = make_family(ENV, **SETTING)


def keep(name: str, net: torch.nn.Sequential) -> str:
    """Write a policy's two files; returns what to call it as a controller."""
    linear = [part for part in net if isinstance(part, torch.nn.Linear)]
    packed = policy_file.pack([part.weight.detach().numpy().T for part in linear],
                              [part.bias.detach().numpy() for part in linear])
    entries = zip(family.entries(), mean, variance, strict=True)
    card = policy_file.Card(
        format=policy_file.FORMAT, env_id=ENV, environment=SETTING,
        observation=[
            policy_file.ObservedEntry(name=e.name, meaning=e.meaning, mean=m, variance=v) for e, m, v in entries
        ],
        epsilon=EPSILON, clip=CLIP, action=policy_file.meanings(family), widths=WIDTHS, activation="tanh",
        output="clip", arrays_sha256=policy_file.digest(packed), algorithm=name, command="notebooks/13-offline",
        seed=seed, steps=len(inputs), versions={"python": platform.python_version(), "torch": version("torch")},
    )
    policy_file.write(card, packed, Path(f"{name}.json"))
    return f"policy:{name}.json"


named = {keep(name, net): name for name, net in policies.items()}

# %% [markdown]
# ## Results
#
# The networks cut on machines that are in no record. The score is 0 for `fixed`, and 1 for a reference that sees
# the gap.

# %%
compared = evaluate(ENV, [*named, "fixed", "counts", "voltage"], machines, resolution="fast")
Markdown("\n".join(markdown_table(compared)))

# %%
figure, axes = plt.subplots(figsize=(7.0, 3.0))
LABELS = {**named, "fixed": "fixed", "counts": "counts", "voltage": "voltage"}
for row, name in enumerate(LABELS):
    returns = [result.total_return for result in compared.results[name]]
    axes.plot(returns, [row] * len(returns), "o", ms=4, alpha=0.6, color=VERMILION if name in named else BLUE)
    axes.plot(np.mean(returns), row, "|", ms=18, mew=2, color=ORANGE)
axes.set(yticks=range(len(LABELS)), yticklabels=LABELS.values(), xlabel="return of a held-back machine (bar: mean)")
axes.invert_yaxis()
figure.tight_layout()

# %%
mean_return = {label: np.mean([r.total_return for r in compared.results[name]]) for name, label in LABELS.items()}
best = max(("fixed", "counts", "voltage"), key=mean_return.__getitem__)
for label in policies:
    print(f"{label}: {mean_return[label] / mean_return[best]:.0%} of the mean return of `{best}`, "
          "the best of those that were recorded")

# %% [markdown]
# Both networks are worse than the best law of the records. In the mean both earn about a third of `voltage`'s
# return, and less than `fixed`, although with eight machines their intervals contain the return of `fixed`. On two
# machines they cut like the laws. On the other six they hardly move, and earn less than 200: a third of the records
# are of a constant feed, and where a network is slower than the records it meets windows that are in no record. The
# return of a window also depends on constants of the machine that the observation does not show. So a high advantage
# may mean an easy machine, not a good action.
#
# ## Limits
#
# - There is one seed, and one temperature of the weights: 0.3 in place of 1 gave a policy that hardly feeds. We did
#   not use methods for hidden machines, with a memory, or with pessimism about untried actions.
# - A clone is not better than its records, and fails in states that none of the three controllers visited.
# - Records with more breaks are made in `edmsim/ThinWire-v1`; `info["cost"]` is in every data set.
