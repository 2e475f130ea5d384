"""Golden logs: what a log of each format version says, and how the current one was made.

``python tests/helpers/golden.py`` writes the files of the current format version. It refuses to
overwrite: a version that people have logs of must be read as it is, for ever.
"""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path

from drawing import plan, show
from mapreplay.config import EpisodeConfig
from mapreplay.episode import prepare_episode, run_episode
from mapreplay.planners.random import RandomExploration
from mapreplay.recorders.log.header import FORMAT_VERSION
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.recorders.log.writer import EpisodeWriter
from mapreplay.step import Step, StepProfile
from recordings import BlurPredictor

FOLDER = Path(__file__).parents[1] / "recorders" / "golden"

TWO_ROOMS = """
    ############
    #....#.....#
    #....#.....#
    #....#.....#
    #..........#
    #....#.....#
    ####.#.....#
    ...#.#.....#
    ####.###.###
    #..........#
    #..........#
    ############
"""


def described(log: EpisodeLog) -> str:
    """All that a log says, as JSON; maps as drawings, the top row first."""
    header, summary = log.header, log.summary
    said = {
        "config": header.config.model_dump(mode="json"),
        "floor_plan": [
            header.floor_plan.id,
            header.floor_plan.resolution,
            *header.floor_plan.origin,
        ],
        "truth": show(header.floor_plan.cells).splitlines(),
        "start": header.start,
        "max_steps": header.max_steps,
        "predictor": asdict(header.predictor),
        "versions": header.versions,
        "summary": asdict(summary) if summary else None,
        "table": log.table().to_dicts(),
        "steps": [_described_step(step) for step in log],
    }
    return json.dumps(said, indent=1, sort_keys=True) + "\n"


def _described_step(step: Step) -> dict[str, object]:
    decision = step.decision
    return {
        "index": step.index,
        "agent": step.agent,
        "hits": " ".join(map(str, step.hits)),
        "observed": show(step.observed).splitlines(),
        "p_wall": None
        if step.p_wall is None
        else [step.p_wall.dtype.name, step.p_wall.tobytes().hex()],
        "fused": show(step.fused).splitlines(),
        "frontier": str(step.frontier.tolist()),
        "decision": decision
        and {
            "chosen": asdict(decision.chosen),
            "path": str(decision.path.tolist()),
            "mode": decision.mode,
            "rivals": [asdict(rival) for rival in decision.rivals],
            "random_draw": decision.random_draw,
        },
        "metrics": asdict(step.metrics),
        "events": [asdict(event) for event in step.events],
        "outcome": step.outcome,
        "profile": step.profile and asdict(step.profile),
    }


def make(folder: Path) -> Path:
    """Write the golden log of the current format version."""
    path = folder / f"v{FORMAT_VERSION}.mcap"
    values = {"planner": "random", "predictor": "blur", "reach": 4, "max_steps": 5, "seed": 8}
    episode = prepare_episode(
        EpisodeConfig.of(values),
        plan(TWO_ROOMS, "two-rooms", resolution=0.25),
        planner=RandomExploration(),
        predictor=BlurPredictor(),
    )
    header = replace(episode.header, versions=(("mapreplay", "0.1.0"),))
    with EpisodeWriter(path, header, profile=True) as writer:
        for step in run_episode(episode):
            writer.add(replace(step, profile=StepProfile(*range(5))))
    path.with_suffix(".json").write_text(described(EpisodeLog(path)))
    return path


if __name__ == "__main__":
    make(FOLDER)
