"""How an episode looks in Rerun: entity paths, and the arrangement of the views."""

from __future__ import annotations

from enum import StrEnum
from typing import Final

import rerun as rr
import rerun.blueprint as rrb

from mapreplay.recorders.palette import Curve
from mapreplay.recorders.scene import curves, has_prediction
from mapreplay.step import EpisodeHeader

TIMELINE: Final = "step"
FRAMES_PER_SECOND: Final = 20.0
MARGIN: Final = 0.02
"""Around a map, as a share of its longer side."""


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
    FRONTIER = "plan/frontier"
    PATH = "plan/path"
    TARGET = "plan/target"
    SCORES = "scores"
    EVENTS = "events"
    HEADER = "header"

    def below(self, root: str) -> str:
        """The absolute path under `root`, which is "" or "/..." without a slash at its end."""
        return f"{root}/{self}"


def curve_path(curve: Curve, root: str) -> str:
    """The absolute path of a curve under `root`."""
    return f"{Entity.SCORES.below(root)}/{curve}"


def layout(
    header: EpisodeHeader,
    root: str = "",
    play_state: rrb.components.PlayState = rrb.components.PlayState.Paused,
) -> rrb.Blueprint:
    """The maps side by side over the curves, the events and the header.

    Args:
        header: of the episode; its size and whether it has a prediction decide.
        root: the root that the episode was sent to.
        play_state: whether time stands, plays, or follows the newest step.
    """
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(*_map_views(header, root)),
            rrb.Horizontal(*_text_and_curves(header, root), column_shares=[4, 3, 3]),
            row_shares=[3, 2],
        ),
        rrb.TimePanel(
            state="collapsed", timeline=TIMELINE, fps=FRAMES_PER_SECOND, play_state=play_state
        ),
        collapse_panels=True,
    )


def application_id(header: EpisodeHeader) -> str:
    """The name that recordings with the same `layout` share.

    A viewer keeps one layout for all recordings of an application.
    """
    height, width = header.floor_plan.shape
    maps = "predicted" if has_prediction(header) else "observed"
    return f"mapreplay-{maps}-{height}x{width}"


def _map_views(header: EpisodeHeader, root: str) -> list[rrb.View | rrb.Container]:
    def view(name: str, *entities: Entity) -> rrb.Spatial2DView:
        # Of the trail each step holds one move, so that its size grows with the number of
        # steps and not with its square; the view joins all moves up to the time cursor.
        whole_trail = rrb.VisibleTimeRanges(
            timeline=TIMELINE,
            start=rr.TimeRangeBoundary.infinite(),
            end=rr.TimeRangeBoundary.cursor_relative(),
        )
        height, width = header.floor_plan.shape
        margin = MARGIN * max(height, width)
        return rrb.Spatial2DView(
            origin=root or "/",
            name=name,
            contents=[entity.below(root) for entity in (*entities, Entity.TRAIL, Entity.AGENT)],
            overrides={Entity.TRAIL.below(root): whole_trail},
            visual_bounds=rrb.VisualBounds2D(
                x_range=[-margin, width + margin], y_range=[-margin, height + margin]
            ),
        )

    plan = (Entity.FRONTIER, Entity.PATH, Entity.TARGET)
    views: list[rrb.View | rrb.Container] = [view("Observed", Entity.OBSERVED, Entity.RAYS)]
    if has_prediction(header):
        views.append(view("Predicted P(wall)", Entity.PREDICTED))
    views.append(view("Fused", Entity.FUSED, *plan))
    views.append(rrb.Tabs(view("Error of fused", Entity.ERROR), view("Truth", Entity.TRUTH)))
    return views


def _text_and_curves(header: EpisodeHeader, root: str) -> list[rrb.View]:
    columns = rrb.encodings.TextLogColumnKind
    return [
        rrb.TimeSeriesView(
            origin=Entity.SCORES.below(root),
            name="F1 and coverage",
            contents=[curve_path(curve, root) for curve in curves(header)],
            axis_y=rrb.ScalarAxis(range=(0.0, 1.02)),
            plot_legend=rrb.Corner2D.RightBottom,
        ),
        rrb.TextLogView(
            origin=Entity.EVENTS.below(root),
            name="Events",
            columns=rrb.TextLogColumns(text_log_columns=[columns.LogLevel, columns.Body]),
        ),
        rrb.TextDocumentView(origin=Entity.HEADER.below(root), name="Episode"),
    ]
