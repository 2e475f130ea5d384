"""Blocking cells, openings and ways out against brute force and networkx, on small random maps."""

from __future__ import annotations

from itertools import combinations

import networkx as nx
import numpy as np
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from beliefs import Belief
from mapreplay.analysis.diagnosis.opening import truly_inside
from mapreplay.analysis.diagnosis.reach import (
    Scratch,
    false_walls,
    has_two_ways_out,
    hidden,
    reached,
)
from mapreplay.grid import FREE, OCCUPIED, UNKNOWN, Cell, Grid
from mapreplay.planning import frontier, shortest_paths

SIDES = st.integers(3, 6)
SETTINGS = settings(
    max_examples=150, deadline=None, suppress_health_check=[HealthCheck.filter_too_much]
)


@st.composite
def beliefs(draw: st.DrawFn) -> Belief:
    """Any map, partly observed, the rest predicted well or badly; the agent where it is free."""
    shape = draw(SIDES), draw(SIDES)
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    truth = np.where(rng.random(shape) < draw(st.sampled_from([0.1, 0.3])), 100, 0).astype(np.int8)
    kind = rng.random(shape)
    unknown, wrong = draw(st.sampled_from([0.1, 0.3])), draw(st.sampled_from([0.3, 0.6]))
    observed = np.where(kind < 0.4, truth, np.int8(UNKNOWN))
    walls = np.where(rng.random(shape) < wrong, np.int8(OCCUPIED), truth)
    predicted = np.where(rng.random(shape) < unknown, np.int8(UNKNOWN), walls)
    free = np.argwhere(observed == FREE)
    assume(len(free))
    agent = Cell(*free[draw(st.integers(0, len(free) - 1))].tolist())
    fused = np.where(observed == UNKNOWN, predicted, observed)
    return Belief(truth, observed, fused, agent)


def graph_of(cells: Grid) -> nx.Graph:
    """The free cells of a map, 8-connected."""
    graph = nx.Graph()
    free = {(int(r), int(c)) for r, c in np.argwhere(cells == FREE)}
    graph.add_nodes_from(free)
    for r, c in free:
        for dr, dc in ((0, 1), (1, -1), (1, 0), (1, 1)):
            if (r + dr, c + dc) in free:
                graph.add_edge((r, c), (r + dr, c + dc))
    return graph


def near(mask: np.ndarray) -> set[tuple[int, int]]:
    """The cells of a mask and their neighbours, one by one."""
    height, width = mask.shape
    return {
        (r, c)
        for r in range(height)
        for c in range(width)
        if mask[max(0, r - 1) : r + 2, max(0, c - 1) : c + 2].any()
    }


def has_frontier(fused: Grid, agent: Cell) -> bool:
    return len(frontier(shortest_paths(fused, agent), fused)) > 0


@SETTINGS
@given(beliefs())
def test_a_way_out_is_a_frontier(b: Belief) -> None:
    assert Scratch(b.fused.shape).has_way_out(b.fused, b.agent) == has_frontier(b.fused, b.agent)


@SETTINGS
@given(beliefs())
def test_blocking_cells_are_a_smallest_of_all_subsets(b: Belief) -> None:
    assume(not has_frontier(b.fused, b.agent))
    wrong = [tuple(cell) for cell in np.argwhere(false_walls(b.truth, b.observed, b.fused))]
    assume(len(wrong) <= 12)
    found = b.blocking()
    solutions: list[set[tuple[int, int]]] = []
    for size in range(1, len(wrong) + 1):
        for chosen in combinations(wrong, size):
            fused = b.fused.copy()
            for cell in chosen:
                fused[cell] = FREE
            if has_frontier(fused, b.agent):
                solutions.append({(int(r), int(c)) for r, c in chosen})
        if solutions:
            break
    if not solutions:
        assert found is None
        return
    assert found is not None
    assert {tuple(cell) for cell in found.cells.tolist()} in solutions
    assert {tuple(cell) for cell in found.tied.tolist()} == set().union(*solutions)
    assert found.unique == (len(solutions) == 1)


@SETTINGS
@given(beliefs())
def test_the_blocking_cells_exist_where_something_is_hidden(b: Belief) -> None:
    assume(not has_frontier(b.fused, b.agent))
    if hidden(b.truth, b.fused, b.agent).any():
        assert b.blocking() is not None


@SETTINGS
@given(beliefs())
def test_the_opening_is_a_minimum_cut(b: Belief) -> None:
    assume(not has_frontier(b.fused, b.agent))
    unseen = hidden(b.truth, b.fused, b.agent)
    inside = truly_inside(b.truth, reached(b.fused, b.agent), b.agent)
    found = b.opening()
    graph = graph_of(b.truth)
    within = {(int(r), int(c)) for r, c in np.argwhere(inside)}
    goals = (near(unseen) & set(graph)) - within
    for cell in within:
        graph.remove_node(cell)
    entries = (near(inside) & set(graph)) - within
    graph.add_edges_from(("source", cell) for cell in entries)
    graph.add_edges_from((cell, "sink") for cell in goals)
    if not entries or not goals or not nx.has_path(graph, "source", "sink"):
        assert found is None
        return
    assert found is not None
    assert found.width == len(nx.minimum_node_cut(graph, "source", "sink"))
    cut = {tuple(cell) for cell in found.cells.tolist()}
    graph.remove_nodes_from(cut)
    assert not nx.has_path(graph, "source", "sink")


@SETTINGS
@given(beliefs())
def test_two_ways_are_two_disjoint_paths(b: Belief) -> None:
    graph = graph_of(b.fused)
    goals = near(b.fused == UNKNOWN) & set(graph)
    agent = (b.agent.row, b.agent.col)
    if agent in goals:
        assert has_two_ways_out(b.fused, b.agent)
        return
    graph.add_edges_from((cell, "out") for cell in goals)
    ways = nx.node_connectivity(graph, agent, "out") if goals else 0
    assert has_two_ways_out(b.fused, b.agent) == (ways >= 2)
