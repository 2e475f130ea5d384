"""The in-fill oracle: what it knows and what it does not, and that no name leads to it."""

import numpy as np

from drawing import draw, plan
from mapreplay import plugins
from mapreplay.analysis.experiment.infill import InFill

HOUSE = plan("""
    #######
    #..#..#
    #.....#
    #######
""")


def test_it_is_right_near_the_observed_and_says_the_share_elsewhere() -> None:
    observed = draw("""
        ???????
        ???????
        ?.?????
        ???????
    """)
    p_wall = InFill(HOUSE, radius=1, wall_share=0.25).predict(observed)
    assert p_wall[::-1].tolist() == [
        [0.25, 0.25, 0.25, 0.25, 0.25, 0.25, 0.25],
        [1, 0, 0, 0.25, 0.25, 0.25, 0.25],
        [1, 0, 0, 0.25, 0.25, 0.25, 0.25],
        [1, 1, 1, 0.25, 0.25, 0.25, 0.25],
    ]


def test_far_enough_it_knows_everything() -> None:
    observed = draw("???????\n???????\n?.?????\n???????")
    p_wall = InFill(HOUSE, radius=8, wall_share=0.25).predict(observed)
    assert (p_wall == (HOUSE.cells == 100)).all()


def test_nothing_observed_nothing_known() -> None:
    p_wall = InFill(HOUSE, radius=4, wall_share=0.25).predict(np.full((4, 7), -1, np.int8))
    assert (p_wall[0] == np.float32(0.25)).all()


def test_no_name_leads_to_it() -> None:
    assert not any("infill" in name for name in plugins.available(plugins.PluginKind.PREDICTORS))
    assert InFill(HOUSE, 2, 0.25).identity.name == "infill-2"
