"""What it means: metrics of logs, comparison, diff, what-if, diagnosis and experiments.

    log = EpisodeLog(path)
    measure_log(log).steps                        # a polars frame, one row a step
    diff_logs(log, other).cause                   # where two episodes diverge
    what_if(log, [0.9, 0.95], [0.9, 0.95]).f1     # float64[steps, 2, 2]
    compare(group_episodes(map(read_episode, paths), ["planner"]), "nearest")

Every analysis is a pure function from logs to a typed result, and a ``..._frame`` makes a table
of it. The names below are imported when they are first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mapreplay.analysis.branching import branch
    from mapreplay.analysis.bundling import bundle
    from mapreplay.analysis.comparison.compare import compare, comparison_frame
    from mapreplay.analysis.comparison.groups import group_episodes
    from mapreplay.analysis.diagnosis.diagnosis import diagnose
    from mapreplay.analysis.diff.divergence import find_divergences
    from mapreplay.analysis.diff.pair import diff_frame, diff_logs
    from mapreplay.analysis.episodes.corpus import pair, read_episode
    from mapreplay.analysis.metrics.measure import measure_log
    from mapreplay.analysis.metrics.per_episode import episode_metrics
    from mapreplay.analysis.verification import verify, verify_rerun
    from mapreplay.analysis.whatif.grid import what_if, what_if_frame


__all__ = [
    "branch",
    "bundle",
    "compare",
    "comparison_frame",
    "diagnose",
    "diff_frame",
    "diff_logs",
    "episode_metrics",
    "find_divergences",
    "group_episodes",
    "measure_log",
    "pair",
    "read_episode",
    "verify",
    "verify_rerun",
    "what_if",
    "what_if_frame",
]

_HOMES = {
    "branch": "branching",
    "bundle": "bundling",
    "compare": "comparison.compare",
    "comparison_frame": "comparison.compare",
    "diagnose": "diagnosis.diagnosis",
    "diff_frame": "diff.pair",
    "diff_logs": "diff.pair",
    "episode_metrics": "metrics.per_episode",
    "find_divergences": "diff.divergence",
    "group_episodes": "comparison.groups",
    "measure_log": "metrics.measure",
    "pair": "episodes.corpus",
    "read_episode": "episodes.corpus",
    "verify": "verification",
    "verify_rerun": "verification",
    "what_if": "whatif.grid",
    "what_if_frame": "whatif.grid",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'mapreplay.analysis' has no attribute {name!r}")
    return getattr(import_module(f"mapreplay.analysis.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return __all__
