"""The layout of episodes in Rerun: entity paths, and the arrangement of the views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import rerun as rr
import rerun.blueprint as rrb

from mapreplay.recorders.pictures.layers import (
    COMPARED,
    MapView,
    curves,
    has_prediction,
    has_truth,
    map_views,
)
from mapreplay.recorders.pictures.palette import Curve
from mapreplay.step import EpisodeHeader

TIMELINE: Final = "step"
FRAMES_PER_SECOND: Final = 20.0
MARGIN: Final = 0.02
"""Around a map, as a share of its longer side."""
PAPER: Final = (16, 18, 22)
"""Behind the legend."""


class Entity(StrEnum):
    """Where things are logged, below the root of their episode."""

    MAPS = "maps"
    TRUTH = "maps/truth"
    OBSERVED = "maps/observed"
    PREDICTED = "maps/predicted"
    FUSED = "maps/fused"
    ERROR = "maps/error"
    AGENT = "agent/position"
    TRAIL = "agent/trail"
    RAYS = "agent/rays"
    HITS = "agent/hits"
    FRONTIER = "plan/frontier"
    RIVALS = "plan/rivals"
    PATH = "plan/path"
    TARGET = "plan/target"
    MARKS = "marks"
    SCORES = "scores"
    STAGES = "stages"
    STATE = "state"
    EVENTS = "events"
    DECISION = "decision"
    HEADER = "header"

    def below(self, root: str) -> str:
        """The absolute path under `root`, which is "" or "/..." without a slash at its end."""
        return f"{root}/{self}"


# What belongs to all episodes of a recording together.
LEGEND: Final = "/legend"
DIVERGENCE: Final = "/divergence"
NOTE: Final = "/note"
"""Shown in place of a map that an episode does not have."""

_MAPS: Final[dict[MapView, Entity]] = {
    MapView.OBSERVED: Entity.OBSERVED,
    MapView.PREDICTED: Entity.PREDICTED,
    MapView.FUSED: Entity.FUSED,
    MapView.ERROR: Entity.ERROR,
    MapView.TRUTH: Entity.TRUTH,
}

_ON_MAPS: Final[dict[MapView, tuple[Entity, ...]]] = {
    MapView.OBSERVED: (Entity.RAYS, Entity.HITS),
    MapView.FUSED: (Entity.FRONTIER, Entity.RIVALS, Entity.PATH, Entity.TARGET, Entity.MARKS),
    MapView.ERROR: (Entity.MARKS,),
    MapView.TRUTH: (Entity.MARKS,),
}
"""What is drawn over each map, besides the agent and its trail."""


def curve_path(curve: Curve, root: str) -> str:
    """The absolute path of a curve under `root`."""
    return f"{Entity.SCORES.below(root)}/{curve}"


@dataclass(frozen=True, eq=False)
class Pane:
    """One episode's place in a layout."""

    header: EpisodeHeader
    root: str = ""
    """The path that it is sent to."""
    name: str = ""
    """Its letter begins the titles of its views; empty if it is the only episode."""
    has_maps: bool = True
    profiled: bool = False

    def title(self, text: str) -> str:
        """The title of one of its views."""
        return f"{self.name[:1]}  {text}" if self.name else text


def layout(
    panes: Sequence[Pane], play_state: rrb.components.PlayState = rrb.components.PlayState.Paused
) -> rrb.Blueprint:
    """The maps side by side, episodes one above the other, over curves and words.

    Args:
        panes: of the episodes; at least one has maps.
        play_state: whether time is paused, plays, or follows the newest step.
    """
    shown = [pane for pane in panes if pane.has_maps]
    below = _below_one(panes[0]) if len(panes) == 1 else _below_several(panes)
    columns = [v for v in MapView if any(v in map_views(pane.header) for pane in shown)]
    maps = [rrb.Horizontal(*_map_views(pane, columns)) for pane in shown]
    shares = [_share(pane, len(shown)) for pane in shown]
    return rrb.Blueprint(
        rrb.Vertical(*maps, _legend_view(), below, row_shares=[*shares, 1, 11]),
        rrb.TimePanel(
            state="collapsed", timeline=TIMELINE, fps=FRAMES_PER_SECOND, play_state=play_state
        ),
        collapse_panels=True,
    )


def application_id(panes: Sequence[Pane]) -> str:
    """The name that recordings with the same `layout` share.

    A viewer keeps one layout for all recordings of an application.
    """
    kinds = []
    for pane in panes:
        height, width = pane.header.floor_plan.shape
        kinds.append(
            "predicted" if has_prediction(pane.header) else "observed",
        )
        kinds += ["judged"] * has_truth(pane.header) + ["profiled"] * pane.profiled
        kinds.append(f"{height}x{width}" if pane.has_maps else "curves")
    return "-".join(["mapreplay", *kinds])


def _share(pane: Pane, rows: int) -> float:
    """The height share of a row of maps: that of the maps, within bounds that leave room below."""
    height, width = pane.header.floor_plan.shape
    across = len(map_views(pane.header))
    fitting = 13.0 * (height / width) * (4 / across)
    return min(max(fitting, 7.0), 14.0) * (1.0 if rows == 1 else 0.8)


def _map_views(pane: Pane, columns: Sequence[MapView]) -> list[rrb.View | rrb.Container]:
    """The maps of an episode; a note in place of one that only the others have."""
    views: list[rrb.View | rrb.Container] = []
    for view in columns:
        if view not in map_views(pane.header):
            note = rrb.TextDocumentView(origin=NOTE, name=pane.title(view.heading))
            views.append(note)
        elif view is MapView.ERROR:
            views.append(rrb.Tabs(_map_view(pane, view), _map_view(pane, MapView.TRUTH)))
        else:
            views.append(_map_view(pane, view))
    return views


def _map_view(pane: Pane, view: MapView) -> rrb.Spatial2DView:
    root = pane.root
    # Each step holds one move of the trail, so that its size is linear in the number of steps, not
    # quadratic; the view joins all moves up to the time cursor.
    whole_trail = rrb.VisibleTimeRanges(
        timeline=TIMELINE,
        start=rr.TimeRangeBoundary.infinite(),
        end=rr.TimeRangeBoundary.cursor_relative(),
    )
    height, width = pane.header.floor_plan.shape
    margin = MARGIN * max(height, width)
    entities = (_MAPS[view], *_ON_MAPS.get(view, ()), Entity.TRAIL, Entity.AGENT)
    return rrb.Spatial2DView(
        origin=root or "/",
        name=pane.title(view.heading),
        contents=[
            f"{entity.below(root)}/**" if entity is Entity.MARKS else entity.below(root)
            for entity in entities
        ],
        overrides={Entity.TRAIL.below(root): whole_trail},
        visual_bounds=rrb.VisualBounds2D(
            x_range=[-margin, width + margin], y_range=[-margin, height + margin]
        ),
    )


def _legend_view() -> rrb.Spatial2DView:
    return rrb.Spatial2DView(
        origin=LEGEND, name="Legend", contents=[LEGEND], titlebar=False, background=PAPER
    )


def _below_one(pane: Pane) -> rrb.Container:
    scores: list[rrb.View] = [
        _curves_view("Scores", [curve_path(curve, pane.root) for curve in curves(pane.header)])
    ]
    if pane.profiled:
        scores.append(
            rrb.TimeSeriesView(
                origin=Entity.STAGES.below(pane.root),
                name="Step time, ms",
                plot_legend=rrb.Corner2D.RightTop,
            )
        )
    return rrb.Horizontal(
        rrb.Vertical(rrb.Tabs(*scores), _state_view([pane]), row_shares=[7, 2]),
        _decision_view(pane),
        rrb.Vertical(
            _events_view([pane]),
            _header_view(pane),
            row_shares=[4, 5],
        ),
        column_shares=[9, 7, 8],
    )


def _below_several(panes: Sequence[Pane]) -> rrb.Container:
    plots = [
        _curves_view(
            curve.label[0].upper() + curve.label[1:],
            [*(curve_path(curve, p.root) for p in panes), f"{DIVERGENCE}/at/**"],
        )
        for curve in COMPARED
    ]
    shown = [pane for pane in panes if pane.has_maps]
    words: list[rrb.View | rrb.Container] = [
        rrb.Tabs(_decision_view(pane), _header_view(pane)) for pane in shown
    ]
    words.append(_events_view(shown))
    return rrb.Horizontal(
        rrb.Vertical(
            rrb.Horizontal(*plots), _state_view(panes), row_shares=[7, 1 + 1.5 * len(shown)]
        ),
        *words,
        column_shares=[12, *[5] * len(words)],
    )


def _curves_view(name: str, paths: Sequence[str]) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(
        origin="/",
        name=name,
        contents=list(paths),
        axis_y=rrb.ScalarAxis(range=(0.0, 1.02)),
        plot_legend=rrb.Corner2D.RightBottom,
    )


def _state_view(panes: Sequence[Pane]) -> rrb.StateTimelineView:
    paths = [Entity.STATE.below(pane.root) for pane in panes if pane.has_maps]
    return rrb.StateTimelineView(origin="/", name="State", contents=paths, titlebar=False)


def _decision_view(pane: Pane) -> rrb.TextDocumentView:
    return rrb.TextDocumentView(
        origin=Entity.DECISION.below(pane.root), name=pane.title("Decision")
    )


def _header_view(pane: Pane) -> rrb.TextDocumentView:
    return rrb.TextDocumentView(origin=Entity.HEADER.below(pane.root), name=pane.title("Episode"))


def _events_view(panes: Sequence[Pane]) -> rrb.TextLogView:
    columns = rrb.encodings.TextLogColumnKind
    return rrb.TextLogView(
        origin="/",
        name="Events",
        contents=[*(Entity.EVENTS.below(pane.root) for pane in panes), f"{DIVERGENCE}/events"],
        columns=rrb.TextLogColumns(text_log_columns=[columns.Body]),
    )
