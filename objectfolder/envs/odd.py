"""A small net that finds the odd one of a row by taps: the trained baseline of ``ObjectFolder/Tap-v0``."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch

from objectfolder.envs.ears import EXTREME, features
from objectfolder.envs.tap import TapEnv

WIDTH, EMBEDDED = 96, 32  #: sizes of the hidden layer, and of what is kept of a tap
SURE = (0.7, 0.8, 0.9, 0.95, 0.98)  #: probabilities at which it may be told to declare


class OddEar:
    """Trained on taps of rows, it answers how probable it is that each object is the odd one.

    Taps are embedded one by one; means of an object's taps are compared with means of all others' taps.

    Parameters
    ----------
    heard : (N, K, M, F) array
        M taps of each of the K objects of N rows; see `objectfolder.envs.ears.features`.
    odd : (N,) int array
        Numbers of the odd ones.
    stuff : (N, K) int array
        Numbers of the materials, which guide the training.
    epochs : int
    seed : int
        Of the initial weights, of dropout and of the taps that a net sees at a time.
    """

    def __init__(
        self, heard: np.ndarray, odd: np.ndarray, stuff: np.ndarray, epochs: int = 60, seed: int = 0
    ):
        axes = tuple(range(heard.ndim - 1))
        self._mean, self._std = heard.mean(axes), heard.std(axes) + 1e-4
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            x = self._scaled(heard)
            right, made = torch.from_numpy(np.asarray(odd)).long(), torch.from_numpy(np.asarray(stuff)).long()
            rows, count, most = x.shape[:3]
            self.tap = torch.nn.Sequential(
                torch.nn.Linear(x.shape[-1], WIDTH), torch.nn.ReLU(), torch.nn.Dropout(0.3),
                torch.nn.Linear(WIDTH, EMBEDDED),
            )  # fmt: skip
            self.score = torch.nn.Sequential(
                torch.nn.Linear(4 * EMBEDDED + 2, WIDTH), torch.nn.ReLU(), torch.nn.Dropout(0.3),
                torch.nn.Linear(WIDTH, 1),
            )  # fmt: skip
            named = torch.nn.Linear(EMBEDDED, int(made.max()) + 1)
            nets = torch.nn.ModuleList([self.tap, self.score, named])
            optimizer = torch.optim.AdamW(nets.parameters(), 1e-3, weight_decay=0.02)
            for _ in range(epochs):
                for some in torch.randperm(rows).split(32):
                    order = torch.rand(len(some), count, most).argsort(-1)
                    tapped = order < torch.randint(most + 1, (len(some), count, 1))
                    embedded = self.tap(x[some])
                    loss = torch.nn.functional.cross_entropy(self._scores(embedded, tapped), right[some])
                    told = named(embedded).flatten(0, 2)
                    truth = made[some][:, :, None].expand(-1, -1, most).flatten()
                    loss = loss + torch.nn.functional.cross_entropy(told, truth)
                    optimizer.zero_grad()
                    loss.backward()
                    optimizer.step()
        nets.eval()

    @torch.no_grad()
    def __call__(self, taps: Sequence[Sequence[np.ndarray]]) -> np.ndarray:
        """Return probabilities (K,) of being the odd one, given features (F,) of each object's taps.

        At least one object was tapped.
        """
        count = [len(of) for of in taps]
        tapped = torch.arange(max(count)) < torch.tensor(count)[:, None]
        embedded = torch.zeros(len(taps), max(count), EMBEDDED)
        embedded[tapped] = self.tap(self._scaled(np.stack([one for of in taps for one in of])))
        scores = self._scores(embedded[None], tapped[None])
        found: np.ndarray = scores[0].softmax(0).numpy()
        return found

    def _scores(self, embedded: torch.Tensor, tapped: torch.Tensor) -> torch.Tensor:
        """Return logits (N, K) of embedded taps (N, K, M, EMBEDDED), of which those (N, K, M) were made."""
        made = tapped[..., None].float()
        own, number = (embedded * made).sum(2), made.sum(2)
        rest, others = own.sum(1, keepdim=True) - own, number.sum(1, keepdim=True) - number
        own, rest = own / number.clip(1), rest / others.clip(1)
        apart = torch.where((number > 0) & (others > 0), own - rest, 0.0)
        known = [own, rest, apart, apart.abs(), number / (1 + number), others / (1 + others)]
        return self.score(torch.cat(known, 2))[..., 0]

    def _scaled(self, heard: np.ndarray) -> torch.Tensor:
        return torch.from_numpy(((heard - self._mean) / self._std).clip(-EXTREME, EXTREME)).float()


def find_odd(env: TapEnv, ear: OddEar, sure: float, seed: int) -> dict[str, Any]:
    """Play one episode; return whether the answer was ``right``, the number of ``taps`` and the ``reward``.

    The next tap is of the object with the greatest probability over one more than its taps, of untapped
    ones first. An object that is as probable as ``sure`` is declared, and the likeliest before the last tap.
    """
    env.reset(seed=seed)
    heard: list[list[np.ndarray]] = [[] for _ in range(env.count)]
    chances, reward, taps = np.full(env.count, 1 / env.count), 0.0, 0
    while chances.max() < sure and taps < env.limit - 1:
        made = np.array([len(of) for of in heard])
        chosen = int(np.where(made == 0, 1.0, chances / (1 + made)).argmax())
        observation, earned, *_ = env.step(chosen)
        heard[chosen].append(features(observation["sound"], env.sample_rate)[0])
        chances, reward, taps = ear(heard), reward + earned, taps + 1
    _, earned, *_ = env.step(env.count + int(chances.argmax()))
    return {"right": earned > 0, "taps": taps, "reward": reward + earned}
