"""How an episode looks in Rerun: entity paths, colours, and the arrangement of the views.

The colours are those of Okabe and Ito (2008), which people with any kind of colour blindness
can tell apart. A colour means the same in every view.
"""

from __future__ import annotations

from enum import IntEnum, StrEnum
from typing import Final, TypeAlias

import rerun as rr
import rerun.blueprint as rrb

from mapreplay.predictors import NoPredictor
from mapreplay.step import EpisodeHeader

TIMELINE: Final = "step"
FRAMES_PER_SECOND: Final = 20.0
MARGIN: Final = 0.02
"""Around a map, as a share of its longer side."""

Colour: TypeAlias = tuple[int, int, int]

ORANGE: Final = (230, 159, 0)
SKY_BLUE: Final = (86, 180, 233)
GREEN: Final = (0, 158, 115)
YELLOW: Final = (240, 228, 66)
BLUE: Final = (0, 114, 178)
VERMILION: Final = (213, 94, 0)
PURPLE: Final = (204, 121, 167)


class CellClass(IntEnum):
    """What a cell of a map is shown as: the class ids of all segmentation images."""

    UNKNOWN = 0
    FREE = 1
    OCCUPIED = 2
    FALSE_WALL = 3
    FALSE_FREE = 4
    NOT_EXPLORABLE = 5


CELL_COLOURS: Final[dict[CellClass, Colour]] = {
    CellClass.UNKNOWN: (128, 128, 128),
    CellClass.FREE: (240, 240, 240),
    CellClass.OCCUPIED: (25, 25, 25),
    CellClass.FALSE_WALL: VERMILION,
    CellClass.FALSE_FREE: SKY_BLUE,
    CellClass.NOT_EXPLORABLE: (66, 72, 92),
}

AGENT_COLOUR: Final = PURPLE
RAYS_COLOUR: Final = BLUE
FRONTIER_COLOUR: Final = ORANGE
PLAN_COLOUR: Final = GREEN


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


class Curve(StrEnum):
    """A score that is drawn over the steps: a field of `mapreplay.step.StepMetrics`."""

    F1 = "f1"
    COVERAGE_OBSERVED = "coverage_observed"
    COVERAGE_FUSED = "coverage_fused"
    CORRECT_COVERAGE = "correct_coverage_fused"

    def below(self, root: str) -> str:
        """The absolute path under `root`."""
        return f"{Entity.SCORES.below(root)}/{self}"

    @property
    def label(self) -> str:
        """What the legend calls it."""
        return "F1" if self is Curve.F1 else self.value.replace("_", " ")


CURVE_COLOURS: Final[dict[Curve, Colour]] = {
    Curve.F1: YELLOW,
    Curve.COVERAGE_OBSERVED: SKY_BLUE,
    Curve.COVERAGE_FUSED: ORANGE,
    Curve.CORRECT_COVERAGE: GREEN,
}


def curves(header: EpisodeHeader) -> tuple[Curve, ...]:
    """The curves that say something: without a prediction, fused is observed."""
    if has_prediction(header):
        return tuple(Curve)
    return (Curve.F1, Curve.COVERAGE_OBSERVED)


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


def has_prediction(header: EpisodeHeader) -> bool:
    """Whether there is a prediction to show."""
    return header.predictor != NoPredictor.identity


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
            contents=[curve.below(root) for curve in curves(header)],
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
