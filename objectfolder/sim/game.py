"""What the environments of this package share: how an episode begins, and how a copy goes on."""

from typing import Any

import gymnasium
import numpy as np

from objectfolder.sim.calls import refuse_options


class Game(gymnasium.Env[Any, Any]):
    """An environment of which a pickle holds the arguments, the episode and the random generator.

    So a copy goes on as the original does. Subclasses draw an episode in ``_begin``, keep their arguments in
    ``_arguments``, and name in ``_changing`` the attributes that an episode changes.

    Raises
    ------
    ObjectFolderError
        If an argument is wrong; on a step before a reset or with a wrong action; on a reset with options.
    """

    metadata = {"render_modes": []}  # noqa: RUF012 - as the base class has it
    _arguments: tuple[Any, ...]
    _changing: tuple[str, ...] = ()
    _episode: dict[str, Any]  #: what ``info`` tells of the running episode; empty between episodes

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Draw an episode; the same one for the same seed."""
        refuse_options(options)
        super().reset(seed=seed)
        return self._begin(self.np_random)

    def _begin(self, rng: np.random.Generator) -> tuple[Any, dict[str, Any]]:
        raise NotImplementedError

    def __reduce__(self) -> tuple[Any, ...]:
        names = (*self._changing, "_np_random", "_np_random_seed", "spec")
        return type(self), self._arguments, {name: getattr(self, name) for name in names}
