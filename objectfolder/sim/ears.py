"""Small nets that listen: the trained baselines of ``ObjectFolder/Drop-v0`` and ``ObjectFolder/Tap-v0``.

The first names what fell, the second finds the odd one of a row.

What tells a material from another, whatever the object's size, is the loss factor: how fast modes decay for
their frequency. So the net hears how loud each band is, and the loss factors with which it fades.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch.nn.functional import cross_entropy

from objectfolder.base.errors import ObjectFolderError
from objectfolder.sim.tap import TapEnv

WINDOW, HOP = 1024, 256  #: samples
BANDS = 48  #: of equal width on a logarithmic axis
MIN_FREQUENCY = 200.0  #: Hz
HEARING_THRESHOLD = 4e-10  #: sound power below which all is silence, the threshold of hearing, Pa²
LAG = 4  #: frames over which a band fades
FADE_THRESHOLD = 100.0  #: times the threshold of hearing, from which a band is heard to fade
LOSS_RANGE = (10**-4.5, 1.0)  #: range of loss factors in histograms
BINS, GROUPS = 40, 8  #: of loss factors, on a logarithmic axis; and of bands, each with a histogram
QUARTILES = (0.25, 0.5, 0.75)
UNKNOWN_LOSS = -2.5  #: decimal logarithm of the loss factor of bands that are not heard to fade
MAX_DEVIATION = 5.0  #: standard deviations, at which features are clipped
WIDTH = 192  #: of the hidden layers of `Ear`
ODD_WIDTH, EMBEDDED = 96, 32  #: sizes of the hidden layer, and of what is kept of a tap
THRESHOLDS = (0.7, 0.8, 0.9, 0.95, 0.98)  #: probabilities at which it may be told to declare


def features(sounds: np.ndarray, sample_rate: float) -> np.ndarray:
    """Return what an ear notices of sounds (N, S), Pa; (N, F) float32.

    For each of the `BANDS`: mean and maximum over time of its power, Pa², as decimal logarithm; the centre of
    its power, relative to the band's; whether it is heard to fade, and the quartiles of its loss factors,
    as decimal logarithms. Then histograms of loss factors, in each of the `GROUPS` of bands and in all.
    A band of frequency f whose power falls from P to Q in a time t has the loss factor
    ln(P / Q) / (2 pi f t). Raises ObjectFolderError if sounds are shorter than the fading of one band.
    """
    wave = torch.from_numpy(np.atleast_2d(sounds)).float()
    least = WINDOW + LAG * HOP
    if wave.shape[1] < least:
        raise ObjectFolderError(f"sounds have {wave.shape[1]} samples, expected at least {least}")
    window = torch.hann_window(WINDOW)
    spectra = torch.stft(wave, WINDOW, HOP, window=window, center=False, return_complex=True)
    inside, hertz = _bands(sample_rate)
    power = spectra.abs() ** 2 / (WINDOW**2 / 4)
    bands = inside @ power  # (N, BANDS, T)
    total = bands.sum(2)
    own = (inside * hertz).sum(1) / inside.sum(1)
    centre = torch.where(total > 0, ((inside * hertz) @ power).sum(2) / total.clip(1e-30), own)
    before, after = bands[..., :-LAG], bands[..., LAG:]
    loud, faint = FADE_THRESHOLD * HEARING_THRESHOLD, 0.1 * FADE_THRESHOLD * HEARING_THRESHOLD
    fades = (before > loud) & (after > faint) & (after < before)
    rate = torch.log(before.clip(1e-30) / after.clip(1e-30)) * (sample_rate / (LAG * HOP))
    loss = torch.log10((rate / (2 * np.pi * centre[..., None])).clip(*LOSS_RANGE))
    quartiles = torch.where(fades, loss, torch.nan).nanquantile(torch.tensor(QUARTILES), 2).movedim(0, 2)
    known = fades.any(2)
    level = torch.log10(bands + HEARING_THRESHOLD)
    parts = [level.mean(2), level.amax(2), centre / own, known.float()]
    parts.append(torch.where(known[..., None], quartiles, UNKNOWN_LOSS).flatten(1))
    parts.append(_histograms(loss, torch.where(fades, torch.log10(before / faint), 0.0)))
    return torch.cat(parts, 1).numpy()


def _bands(sample_rate: float) -> tuple[torch.Tensor, torch.Tensor]:
    """Return which frequencies are in which band (BANDS, F), 0 or 1, and the frequencies (F,), Hz."""
    edges = np.geomspace(MIN_FREQUENCY, sample_rate / 2, BANDS + 1)
    hertz = np.arange(WINDOW // 2 + 1) * sample_rate / WINDOW
    inside = (hertz >= edges[:-1, None]) & (hertz < edges[1:, None])
    nearest = abs(hertz - np.sqrt(edges[1:] * edges[:-1])[:, None]).argmin(1)
    inside[np.arange(BANDS), nearest] = True  # the lowest bands are narrower than a bin
    return torch.from_numpy(inside.astype(np.float32)), torch.from_numpy(hertz).float()


def _histograms(loss: torch.Tensor, weight: torch.Tensor) -> torch.Tensor:
    """Return shares (N, (GROUPS + 1) BINS) of weights (N, BANDS, T) at logarithms of loss factors."""
    low, high = np.log10(LOSS_RANGE)
    places = ((loss - low) / (high - low) * BINS).long().clip(0, BINS - 1)
    found = torch.zeros(*loss.shape[:2], BINS).scatter_add_(2, places, weight)
    groups = found.reshape(len(found), GROUPS, BANDS // GROUPS, BINS).sum(2)
    groups = torch.cat([groups, groups.sum(1, keepdim=True)], 1)
    return (groups / (groups.sum(2, keepdim=True) + 5)).flatten(1)


def _standardize(heard: np.ndarray, mean: np.ndarray, std: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(((heard - mean) / std).clip(-MAX_DEVIATION, MAX_DEVIATION)).float()


class Ear:
    """Trained on sounds of falls, it answers with objects and materials.

    Parameters
    ----------
    heard : (N, F) array
        See `features`.
    answers : (N, 2) int array
        Numbers of objects and materials.
    kinds : (int, int)
        How many of each there are.
    epochs : int
    seed : int
        Of the initial weights, and of dropout.
    """

    def __init__(
        self, heard: np.ndarray, answers: np.ndarray, kinds: tuple[int, int], epochs: int = 50, seed: int = 0
    ):
        self._kinds, self._mean, self._std = kinds, heard.mean(0), heard.std(0) + 1e-4
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            x, y = _standardize(heard, self._mean, self._std), torch.from_numpy(np.asarray(answers)).long()
            self.net = torch.nn.Sequential(
                torch.nn.Linear(x.shape[1], WIDTH), torch.nn.ReLU(), torch.nn.Dropout(0.3),
                torch.nn.Linear(WIDTH, WIDTH), torch.nn.ReLU(), torch.nn.Dropout(0.3),
                torch.nn.Linear(WIDTH, sum(kinds)),
            )  # fmt: skip
            optimizer = torch.optim.AdamW(self.net.parameters(), 1e-3, weight_decay=0.02)
            for _ in range(epochs):
                for rows in torch.randperm(len(x)).split(64):
                    found = self.net(x[rows]).split(kinds, 1)
                    loss = sum(cross_entropy(of, y[rows, k]) for k, of in enumerate(found))
                    optimizer.zero_grad()
                    loss.backward()  # type: ignore[union-attr]
                    optimizer.step()
        self.net.eval()

    @torch.no_grad()
    def __call__(self, heard: np.ndarray) -> np.ndarray:
        """Return the numbers of objects and materials (N, 2)."""
        found = self.net(_standardize(heard, self._mean, self._std)).split(self._kinds, 1)
        return np.stack([of.argmax(1).numpy() for of in found], 1)


class OddEar:
    """Trained on taps of rows, it answers how probable it is that each object is the odd one.

    Taps are embedded one by one; means of an object's taps are compared with means of all others' taps.

    Parameters
    ----------
    heard : (N, K, M, F) array
        M taps of each of the K objects of N rows; see `objectfolder.sim.ears.features`.
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
            x = _standardize(heard, self._mean, self._std)
            right, made = torch.from_numpy(np.asarray(odd)).long(), torch.from_numpy(np.asarray(stuff)).long()
            rows, count, most = x.shape[:3]
            self.tap = torch.nn.Sequential(
                torch.nn.Linear(x.shape[-1], ODD_WIDTH), torch.nn.ReLU(), torch.nn.Dropout(0.3),
                torch.nn.Linear(ODD_WIDTH, EMBEDDED),
            )  # fmt: skip
            self.score = torch.nn.Sequential(
                torch.nn.Linear(4 * EMBEDDED + 2, ODD_WIDTH), torch.nn.ReLU(), torch.nn.Dropout(0.3),
                torch.nn.Linear(ODD_WIDTH, 1),
            )  # fmt: skip
            named = torch.nn.Linear(EMBEDDED, int(made.max()) + 1)
            nets = torch.nn.ModuleList([self.tap, self.score, named])
            optimizer = torch.optim.AdamW(nets.parameters(), 1e-3, weight_decay=0.02)
            for _ in range(epochs):
                for some in torch.randperm(rows).split(32):
                    order = torch.rand(len(some), count, most).argsort(-1)
                    tapped = order < torch.randint(most + 1, (len(some), count, 1))
                    embedded = self.tap(x[some])
                    loss = cross_entropy(self._scores(embedded, tapped), right[some])
                    told = named(embedded).flatten(0, 2)
                    truth = made[some][:, :, None].expand(-1, -1, most).flatten()
                    loss = loss + cross_entropy(told, truth)
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
        every = np.stack([one for of in taps for one in of])
        embedded[tapped] = self.tap(_standardize(every, self._mean, self._std))
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


def find_odd(env: TapEnv, ear: OddEar, threshold: float, seed: int) -> dict[str, Any]:
    """Play one episode; return whether the answer was ``right``, the number of ``taps`` and the ``reward``.

    The next tap is of the object with the greatest probability over one more than its taps, of untapped
    ones first. An object that is as probable as ``threshold`` is declared, and the likeliest before the last
    tap.
    """
    env.reset(seed=seed)
    heard: list[list[np.ndarray]] = [[] for _ in range(env.count)]
    chances, reward, taps = np.full(env.count, 1 / env.count), 0.0, 0
    while chances.max() < threshold and taps < env.limit - 1:
        made = np.array([len(of) for of in heard])
        chosen = int(np.where(made == 0, 1.0, chances / (1 + made)).argmax())
        observation, earned, *_ = env.step(chosen)
        heard[chosen].append(features(observation["sound"], env.sample_rate)[0])
        chances, reward, taps = ear(heard), reward + earned, taps + 1
    _, earned, *_ = env.step(env.count + int(chances.argmax()))
    return {"right": earned > 0, "taps": taps, "reward": reward + earned}
