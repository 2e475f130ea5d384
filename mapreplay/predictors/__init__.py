"""Map predictors: from the observed map to the probability of a wall in every cell."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Protocol, cast, runtime_checkable

import numpy as np
import numpy.typing as npt

from mapreplay import plugins
from mapreplay.config import WEIGHTS_ENDING
from mapreplay.errors import PluginError
from mapreplay.files.identify import identify_file
from mapreplay.grid import Grid
from mapreplay.step import PredictorIdentity


class Predictor(Protocol):
    """An object that completes maps."""

    @property
    def identity(self) -> PredictorIdentity:
        """Name, and hash of the weights."""
        ...

    def predict(self, observed: Grid) -> npt.NDArray[np.float32] | None:
        """float32[H, W], P(occupied) in [0, 1] for every cell of `observed` (int8[H, W]).

        None means no prediction: then the fused map is the observed one. The same map must
        always give the same numbers.
        """
        ...


@runtime_checkable
class Choosing(Predictor, Protocol):
    """A predictor that chooses one of several predictors by the map."""

    def choice(self, observed: Grid) -> str | None:
        """A sentence about the choice for that map (int8[H, W]); None if there is none.

        The same map must always give the same sentence; the log says it whenever it changes.
        """
        ...


def choice_of(predictor: Predictor, observed: Grid) -> str | None:
    """A sentence about `predictor`'s choice for that map; None if it never chooses."""
    return predictor.choice(observed) if isinstance(predictor, Choosing) else None


class NoPredictor:
    """Predicts nothing."""

    identity = PredictorIdentity("none", "")

    def predict(self, observed: Grid) -> None:
        """See `Predictor`."""


def no_predictor(device: str) -> NoPredictor:  # noqa: ARG001 (what the entry point is given)
    """The predictor ``none``."""
    return NoPredictor()


def load_predictor(word: str, device: str = "cpu") -> Predictor:
    """The predictor registered as `word`, or the network in the safetensors file `word`.

    Only for words given by the *user*, who decides which files are opened. For names in a log or
    a configuration use `registered_predictor`.

    Raises:
        PluginError: it is unknown or broken.
        WeightsError: the file cannot be read.
    """
    if word.endswith(WEIGHTS_ENDING):
        from mapreplay.predictors.trained import load_network  # torch takes seconds to import

        return load_network(Path(word), device)
    return registered_predictor(word, device)


def registered_predictor(name: str, device: str = "cpu") -> Predictor:
    """The predictor registered as `name`; no file of that name is ever opened.

    Raises:
        PluginError: it is unknown or broken.
    """
    try:
        factory = plugins.load(plugins.PluginKind.PREDICTORS, name)
    except PluginError as error:
        if name in plugins.available(plugins.PluginKind.PREDICTORS):
            raise
        what = identify_file(Path(name))
        is_a = f"; {name} is {what}" if what else ""
        raise PluginError(f"{error}, or a .safetensors file{is_a}") from None
    return cast("Predictor", factory(device))


@lru_cache(maxsize=8)
def kept_predictor(name: str, device: str = "cpu") -> Predictor:
    """`load_predictor`, cached in this process for many episodes."""
    return load_predictor(name, device)
