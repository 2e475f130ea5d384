"""The predictor that a log was recorded with, had again.

A log says its name and the hash of its weights. A name is looked up among the registered
predictors only; a file of weights is opened only if the user gives it.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from mapreplay import plugins
from mapreplay.errors import PluginError
from mapreplay.predictors import Predictor, registered_predictor
from mapreplay.step import EpisodeHeader

_SHOWN: Final = 12


def logged_predictor(
    header: EpisodeHeader, device: str = "cpu", weights: Sequence[Path] = ()
) -> Predictor:
    """The predictor of `header`: from the file among `weights` that has its hash, or a registered
    one of its name, whose hash may be another: that is for the caller to say.

    Raises:
        PluginError: it is not registered, or is broken, and no file has its hash.
        WeightsError: a file cannot be read.
        UsageError: there is no such device.
    """
    logged, name = header.predictor, header.config.predictor
    others = []
    for path in weights:
        from mapreplay.predictors.trained import load_network  # torch takes seconds to import
        from mapreplay.predictors.weights import file_sha256

        sha256 = file_sha256(path)
        if sha256 == logged.sha256:
            return load_network(path, device, name)
        others.append(f"{path} has {sha256[:_SHOWN]}")
    registered = None
    if name in plugins.available(plugins.PluginKind.PREDICTORS):
        registered = registered_predictor(name, device)
        if not others or registered.identity.sha256 == logged.sha256:
            return registered
    hashed = f"sha256 {logged.sha256[:_SHOWN]}" if logged.sha256 else "without a hash"
    here = "registered here with other weights" if registered else "not registered here"
    had = f" ({', '.join(others)})" if others else ""
    raise PluginError(
        f"the log's predictor is {name} ({hashed}), {here}; give its weights with "
        f"--predictor FILE{had}"
    )
