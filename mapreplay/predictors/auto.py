"""The predictor `auto` chooses the predictor for the kind of map, or none.

A small network (one hidden layer) on the runs of the observed map (`auto_features`) estimates
the probability that the floor plan is of D1's kind, of D2's kind, or of neither. If one of the
first two is probable enough, its predictor is used; otherwise there is no prediction, and the fused
map is the observed map. The choice depends on the map alone, and can change with every step.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from mapreplay.errors import WeightsError
from mapreplay.files.whole import write_whole
from mapreplay.grid import Grid
from mapreplay.predictors import Predictor, load_predictor
from mapreplay.predictors.auto_features import WORDS, count_words
from mapreplay.step import PredictorIdentity
from mapreplay.text import one_line

PARAMETERS: Final = Path(__file__).parent / "weights_v1" / "auto.json"
UNSURE: Final = "unsure: nothing is predicted"


class PlanKind(StrEnum):
    """The kinds of floor plans, in the order of the columns of `Classifier.out`."""

    D1 = "d1"
    D2 = "d2"
    NEITHER = "neither"


PREDICTOR_OF: Final[Mapping[PlanKind, str]] = {PlanKind.D1: "d1", PlanKind.D2: "d2"}
"""The registered predictor of each kind; other kinds are not predicted."""


@dataclass(frozen=True, eq=False)
class Classifier:
    """P(kind) = softmax(out relu(hidden log(1 + counts of words) + hidden bias) + out bias)."""

    hidden: npt.NDArray[np.float64]
    """float64[126, n]: of each of `WORDS`."""
    hidden_bias: npt.NDArray[np.float64]
    """float64[n]."""
    out: npt.NDArray[np.float64]
    """float64[n, 3]: for each `PlanKind`."""
    out_bias: npt.NDArray[np.float64]
    """float64[3]."""
    sure: float
    """The probability from which a kind is chosen."""

    def probabilities(self, counts: npt.NDArray[np.int64]) -> npt.NDArray[np.float64]:
        """float64[..., 3]: P(kind) for int64[..., 126] counts of `WORDS`."""
        hidden = np.maximum(np.log1p(counts) @ self.hidden + self.hidden_bias, 0)
        scores = hidden @ self.out + self.out_bias
        odds = np.exp(scores - scores.max(axis=-1, keepdims=True))
        p: npt.NDArray[np.float64] = odds / odds.sum(axis=-1, keepdims=True)
        return p

    def kind(self, observed: Grid) -> PlanKind:
        """The kind of floor plan of int8[H, W] `observed`, or neither."""
        counts = count_words(observed)
        if not counts.any():
            return PlanKind.NEITHER
        p = self.probabilities(counts)
        best = int(p.argmax())
        return list(PlanKind)[best] if p[best] >= self.sure else PlanKind.NEITHER


def read_classifier(path: Path = PARAMETERS) -> Classifier:
    """The classifier whose parameters are in the JSON file `path`.

    Raises:
        WeightsError: it cannot be read, or is of other words or kinds.
    """
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        if data["kinds"] != list(PlanKind) or list(data["hidden"]) != list(WORDS):
            raise WeightsError(f"{path}: a classifier of other words or kinds")
        arrays = [
            np.array(list(data["hidden"].values()), np.float64),
            *(np.array(data[key], np.float64) for key in ("hidden_bias", "out", "out_bias")),
        ]
        sure = float(data["sure"])
    except OSError as error:
        raise WeightsError(f"{path}: cannot be read ({error.strerror})") from None
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise WeightsError(
            f"{path}: not the parameters of a classifier ({one_line(error)})"
        ) from None
    units = arrays[0].shape[-1]
    shapes = [(len(WORDS), units), (units,), (units, len(PlanKind)), (len(PlanKind),)]
    if [a.shape for a in arrays] != shapes or not all(np.isfinite(a).all() for a in arrays):
        raise WeightsError(f"{path}: not the parameters of a classifier (wrong numbers)")
    hidden, hidden_bias, out, out_bias = arrays
    return Classifier(hidden, hidden_bias, out, out_bias, sure)


def save_classifier(classifier: Classifier, path: Path, card: Mapping[str, object]) -> None:
    """Write the parameters to the JSON file `path`; `card` says where they come from."""

    def rounded(values: npt.NDArray[np.float64]) -> list[object]:
        return list(values.round(4).tolist())

    data = {
        **card,
        "kinds": list(PlanKind),
        "sure": classifier.sure,
        "out_bias": rounded(classifier.out_bias),
        "out": rounded(classifier.out),
        "hidden_bias": rounded(classifier.hidden_bias),
        "hidden": dict(zip(WORDS, rounded(classifier.hidden), strict=True)),
    }
    lines = [f" {json.dumps(key)}: {json.dumps(value)}" for key, value in data.items()]
    write_whole(path, ("{\n" + ",\n".join(lines) + "\n}\n").encode(), force=True)


class AutoPredictor:
    """Chooses a predictor, or none, for every map."""

    def __init__(
        self, classifier: Classifier, predictors: Mapping[PlanKind, Predictor], sha256: str
    ) -> None:
        """`sha256` is that of the classifier's parameters; that of `identity` covers all parts."""
        self._classifier = classifier
        self._predictors = dict(predictors)
        parts = [sha256]
        for kind, predictor in sorted(self._predictors.items()):
            parts.append(f"{kind} {predictor.identity.name} {predictor.identity.sha256}")
        digest = hashlib.sha256("\n".join(parts).encode())
        self.identity = PredictorIdentity("auto", digest.hexdigest())

    def predict(self, observed: Grid) -> npt.NDArray[np.float32] | None:
        """See `mapreplay.predictors.Predictor`."""
        predictor = self._predictors.get(self._classifier.kind(observed))
        return None if predictor is None else predictor.predict(observed)

    def choice(self, observed: Grid) -> str:
        """See `mapreplay.predictors.Choosing`."""
        predictor = self._predictors.get(self._classifier.kind(observed))
        return UNSURE if predictor is None else f"{predictor.identity.name} predicts"


def auto(device: str) -> AutoPredictor:
    """The predictor ``auto``.

    Raises:
        WeightsError: its parameters, or a predictor's weights, cannot be read.
        UsageError: there is no such device.
    """
    return AutoPredictor(
        read_classifier(),
        {kind: load_predictor(name, device) for kind, name in PREDICTOR_OF.items()},
        hashlib.sha256(PARAMETERS.read_bytes()).hexdigest(),
    )
