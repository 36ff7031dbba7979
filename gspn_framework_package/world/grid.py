"""The room as a grid: the distance and the path from every cell to a goal.

The cost of a path is its length, with a surcharge near walls. ``Grid.field`` finds the cheapest
paths from every cell to one goal with SciPy's Dijkstra, so a robot that leaves its path needs no
new search.
"""

from __future__ import annotations

import math
from typing import Dict, List, Sequence, Tuple

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from gspn_framework_package.model.net import Point
from gspn_framework_package.world.room import Box, Room

RESOLUTION = 0.05
"""Side length of a cell, in metres."""

SPARE = 0.02
"""A path leads through a cell only if a robot in its centre is this far, in metres, from walls and
obstacles."""

COMFORT = 0.12
"""Distance to a wall or obstacle (beyond the robot's radius), in metres, from which on a path has
no surcharge."""

_TILE = 20  # cells

Disc = Tuple[float, float, float]
"""A disc on the floor: x, y, radius."""


class Field:
    """The cheapest paths from every cell of a grid to one goal.

    :param goal: the goal, in metres.
    :param cost: for each cell, the (weighted) length of the path in metres; infinite if there is
      none.
    :param following: for each cell, the next cell on the path; negative at the goal and if there is
      no path.
    """

    def __init__(self, grid: Grid, goal: Point, cost: np.ndarray, following: np.ndarray) -> None:
        self._grid = grid
        self.goal = goal
        self.costs = cost
        self._following = following

    def start(self, point: Point) -> int:
        """The first cell of the path from a point: its own, or the cheapest one nearby."""
        grid = self._grid
        cell = grid.cell(point)
        if np.isfinite(self.costs[cell]):
            return cell
        near = grid.cells_near(point, 3.5 * RESOLUTION)
        if len(near) == 0:
            return cell
        reach = self.costs[near] + np.hypot(grid.xs[near] - point[0], grid.ys[near] - point[1])
        return int(near[int(np.argmin(reach))])

    def cost(self, point: Point) -> float:
        """Weighted length of the path from a point to the goal in metres; infinite if there is
        none."""
        return float(self.costs[self.start(point)])

    def path(self, point: Point, length: float = math.inf) -> List[Point]:
        """The path from a point: centres of cells, then the goal itself.

        :param length: largest length of the path, in metres.
        """
        grid = self._grid
        cell = self.start(point)
        if not np.isfinite(self.costs[cell]):
            return []
        points: List[Point] = []
        following, xs, ys = self._following, grid.xs, grid.ys
        way = 0.0
        while following[cell] >= 0 and way < length:
            points.append((float(xs[cell]), float(ys[cell])))
            cell = int(following[cell])
            if len(points) > 1:
                way += math.dist(points[-1], points[-2])
        if way < length:
            points.append(self.goal)
        return points


class Grid:
    """The floor of a room in cells of :data:`RESOLUTION`, with the clearance of each."""

    def __init__(self, room: Room) -> None:
        bounds = room.bounds()
        self.room = room
        self.columns = max(math.ceil((bounds.high[0] - bounds.low[0]) / RESOLUTION), 1) + 1
        self.rows = max(math.ceil((bounds.high[1] - bounds.low[1]) / RESOLUTION), 1) + 1
        self._low = bounds.low
        columns, rows = np.meshgrid(np.arange(self.columns), np.arange(self.rows))
        self.xs: np.ndarray = bounds.low[0] + columns.ravel() * RESOLUTION
        self.ys: np.ndarray = bounds.low[1] + rows.ravel() * RESOLUTION
        self._table = self._measure()
        self.clearance: np.ndarray = self._table.ravel()
        # beyond the robot's radius
        spare = self.clearance - room.robot.radius
        self.free: np.ndarray = spare > SPARE
        self._toll = 1.0 + 3.0 * np.clip(1.0 - spare / COMFORT, 0.0, 1.0) ** 2
        self._edges()

    def _measure(self) -> np.ndarray:
        """The distance from each cell to the nearest wall or obstacle, negative inside, metres.

        A distance to a solid differs between two points by no more than they are apart. So in a
        tile of cells, the nearest solid is one that is almost the nearest to the tile's centre.
        """
        xs, ys = (table.reshape(self.rows, self.columns) for table in (self.xs, self.ys))
        tiles = [
            (slice(row, row + _TILE), slice(column, column + _TILE))
            for row in range(0, self.rows, _TILE)
            for column in range(0, self.columns, _TILE)
        ]
        centre_xs, centre_ys = (
            np.array([(table[tile].flat[0] + table[tile].flat[-1]) / 2 for tile in tiles])
            for table in (xs, ys)
        )
        solids = self.room.solids()
        table = np.full(xs.shape, np.inf)
        if not solids:
            return table
        away = np.array([solid.distance(centre_xs, centre_ys) for solid in solids])
        near = away <= away.min(axis=0) + _TILE * RESOLUTION * math.sqrt(2.0)
        for number, tile in enumerate(tiles):
            for index in np.flatnonzero(near[:, number]):
                found = solids[index].distance(xs[tile], ys[tile])
                table[tile] = np.minimum(table[tile], found)
        return table

    def _edges(self) -> None:
        cells = np.arange(self.columns * self.rows)
        column, row = cells % self.columns, cells // self.columns
        tails, heads, lengths = [], [], []
        for dx, dy in ((1, 0), (0, 1), (1, 1), (1, -1), (2, 1), (1, 2), (2, -1), (1, -2)):
            there = (column + dx < self.columns) & (row + dy < self.rows) & (row + dy >= 0)
            tail = cells[there]
            head = tail + dx + dy * self.columns
            open_ = self.free[tail] & self.free[head]
            tail, head = tail[open_], head[open_]
            length = np.full(len(tail), RESOLUTION * math.hypot(dx, dy))
            tails += [tail, head]
            heads += [head, tail]
            lengths += [length, length]
        self._tails = np.concatenate(tails)
        self._heads = np.concatenate(heads)
        toll = (self._toll[self._tails] + self._toll[self._heads]) / 2
        self._weights = np.concatenate(lengths) * toll
        # in the order of a compressed sparse row matrix: each search only replaces the weights
        order = np.lexsort((self._heads, self._tails))
        self._tails, self._heads = self._tails[order], self._heads[order]
        self._weights = self._weights[order]
        counts = np.bincount(self._tails, minlength=len(cells))
        self._rows_start = np.concatenate([[0], np.cumsum(counts)])

    def cell(self, point: Point) -> int:
        """The index of the cell that contains a point; points outside belong to the border."""
        column = min(max(round((point[0] - self._low[0]) / RESOLUTION), 0), self.columns - 1)
        row = min(max(round((point[1] - self._low[1]) / RESOLUTION), 0), self.rows - 1)
        return row * self.columns + column

    def cells_near(self, point: Point, radius: float) -> np.ndarray:
        """The indices of the cells whose centres lie within ``radius`` of a point."""
        return np.flatnonzero(np.hypot(self.xs - point[0], self.ys - point[1]) <= radius)

    def clearance_at(self, xs: np.ndarray, ys: np.ndarray) -> np.ndarray:
        """The clearance at points in metres (bilinear interpolation between the cells)."""
        # np.clip takes three times as long for so few points, and this is called very often
        column = np.minimum(np.maximum((xs - self._low[0]) / RESOLUTION, 0), self.columns - 1.001)
        row = np.minimum(np.maximum((ys - self._low[1]) / RESOLUTION, 0), self.rows - 1.001)
        left, low = column.astype(int), row.astype(int)
        right, up = column - left, row - low
        table = self._table
        return (
            table[low, left] * (1 - right) * (1 - up)
            + table[low, left + 1] * right * (1 - up)
            + table[low + 1, left] * (1 - right) * up
            + table[low + 1, left + 1] * right * up
        )

    def field(self, goal: Point, blocked: Sequence[Disc] = (), dear: Sequence[Disc] = ()) -> Field:
        """The cheapest paths to a goal.

        :param goal: the goal, in metres.
        :param blocked: discs that no path may cross.
        :param dear: discs that paths should avoid: they cost five times as much.
        """
        weights = self._weights
        if blocked or dear:
            weights = weights.copy()
        for x, y, radius in dear:
            inside = np.hypot(self.xs - x, self.ys - y) < radius
            weights[inside[self._heads] | inside[self._tails]] *= 5.0
        for x, y, radius in blocked:
            inside = np.hypot(self.xs - x, self.ys - y) < radius
            weights[inside[self._heads] | inside[self._tails]] = np.inf
        count = self.columns * self.rows
        graph = csr_matrix((weights, self._heads, self._rows_start), shape=(count, count))
        # edges go both ways, so the predecessor on the path from the goal is the next cell on the
        # path to it
        cost, following = dijkstra(
            graph, indices=self.cell(goal), return_predecessors=True, directed=True
        )
        return Field(self, goal, cost, following)

    def is_clear(self, start: Point, end: Point, spare: float) -> bool:
        """Whether a robot can drive straight, with ``spare`` metres of clearance beyond its
        radius."""
        count = max(2, math.ceil(math.dist(start, end) / RESOLUTION) + 1)
        xs = np.linspace(start[0], end[0], count)
        ys = np.linspace(start[1], end[1], count)
        return bool((self.clearance_at(xs, ys) > self.room.robot.radius + spare).all())


def merged_boxes(filled: np.ndarray, size: float, low: Tuple[float, float]) -> List[Box]:
    """Cover the filled cells of a grid exactly with few boxes.

    :param filled: an array of bool, a row for each y.
    :param size: side of a cell, metres.
    :param low: the south-west corner of the first cell.
    """
    upright = _rectangles(filled)
    lying = [(y, x, high, wide) for x, y, wide, high in _rectangles(filled.T)]
    found = min(upright, lying, key=len)
    return [
        Box(
            at=(low[0] + (x + wide / 2) * size, low[1] + (y + high / 2) * size),
            size=(wide * size, high * size),
            height=Room.wall_height,
        )
        for x, y, wide, high in found
    ]


def _rectangles(filled: np.ndarray) -> List[Tuple[int, int, int, int]]:
    """Equal runs of cells in consecutive rows, as x, y, width and height."""
    found: List[Tuple[int, int, int, int]] = []
    begun: Dict[Tuple[int, int], int] = {}
    for y, row in enumerate([*filled, np.zeros(filled.shape[1], bool)]):
        edges = np.flatnonzero(np.diff(np.concatenate([[0], row.astype(np.int8), [0]])))
        runs = {(int(start), int(end)) for start, end in zip(edges[::2], edges[1::2])}
        for run in set(begun) - runs:
            first = begun.pop(run)
            found.append((run[0], first, run[1] - run[0], y - first))
        for run in runs - set(begun):
            begun[run] = y
    return sorted(found)
