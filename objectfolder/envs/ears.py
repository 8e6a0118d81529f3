"""A small net that names what fell by its sound: the trained baseline of ``ObjectFolder/Drop-v0``."""

import numpy as np
import torch

WINDOW, HOP = 1024, 512  #: samples
BANDS = 48  #: of equal width on a logarithmic axis
LOWEST = 200.0  #: Hz
QUIETEST = 1e-7  #: sound power below which all is silence, Pa²
WIDTH = 192  #: of the hidden layers


def features(sounds: np.ndarray, sample_rate: float) -> np.ndarray:
    """Return logarithms of the power in bands over time; sounds (N, S), Pa -> (N, T, BANDS) float32."""
    wave = torch.from_numpy(np.atleast_2d(sounds)).float()
    window = torch.hann_window(WINDOW)
    power = torch.stft(wave, WINDOW, HOP, window=window, center=False, return_complex=True).abs() ** 2
    edges = np.geomspace(LOWEST, sample_rate / 2, BANDS + 1)
    hertz = np.arange(WINDOW // 2 + 1) * sample_rate / WINDOW
    inside = (hertz >= edges[:-1, None]) & (hertz < edges[1:, None])
    nearest = abs(hertz - np.sqrt(edges[1:] * edges[:-1])[:, None]).argmin(1)
    inside[np.arange(BANDS), nearest] = True  # the lowest bands are narrower than a bin
    bands = torch.from_numpy(inside.astype(np.float32)) @ power / (WINDOW**2 / 4)
    return torch.log10(bands + QUIETEST).transpose(1, 2).numpy()


class Ear:
    """Trained on sounds of falls, it answers with objects and materials.

    Parameters
    ----------
    heard : (N, T, BANDS) array
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
        self, heard: np.ndarray, answers: np.ndarray, kinds: tuple[int, int], epochs: int = 60, seed: int = 0
    ):
        self._kinds, self._mean, self._std = kinds, heard.mean((0, 1)), heard.std((0, 1)) + 1e-6
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            x, y = self._scaled(heard), torch.from_numpy(np.asarray(answers)).long()
            self.net = torch.nn.Sequential(
                torch.nn.Linear(x.shape[1], WIDTH), torch.nn.ReLU(), torch.nn.Dropout(0.3),
                torch.nn.Linear(WIDTH, WIDTH), torch.nn.ReLU(), torch.nn.Dropout(0.3),
                torch.nn.Linear(WIDTH, sum(kinds)),
            )  # fmt: skip
            optimizer = torch.optim.AdamW(self.net.parameters(), 1e-3, weight_decay=0.02)
            for _ in range(epochs):
                for rows in torch.randperm(len(x)).split(64):
                    found = self.net(x[rows]).split(kinds, 1)
                    loss = sum(
                        torch.nn.functional.cross_entropy(of, y[rows, k]) for k, of in enumerate(found)
                    )
                    optimizer.zero_grad()
                    loss.backward()  # type: ignore[union-attr]
                    optimizer.step()
        self.net.eval()

    @torch.no_grad()
    def __call__(self, heard: np.ndarray) -> np.ndarray:
        """Return the numbers of objects and materials (N, 2)."""
        return np.stack(
            [of.argmax(1).numpy() for of in self.net(self._scaled(heard)).split(self._kinds, 1)], 1
        )

    def _scaled(self, heard: np.ndarray) -> torch.Tensor:
        return torch.from_numpy((heard - self._mean) / self._std).float().flatten(1)
