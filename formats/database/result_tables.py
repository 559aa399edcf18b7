"""What a build concludes: poses and grid of a map of ours, and what only RTAB-Map's tools read."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from formats.bounds import FARTHEST
from formats.database.blobs import matrix_to_blob, pose_to_blob
from formats.database.transactions import Transactions
from mapmyworld.errors import MapError
from mapmyworld.types import OccupancyGrid, Poses


class ResultTables(Transactions):
    """In double precision in our own tables, and in RTAB-Map's."""

    def set_poses(self, poses: Poses) -> None:
        self._begin()
        self._write("poses ids", poses.ids)
        self._write("poses map_from_node", poses.map_from_node)
        self._write("poses covariances", poses.covariances)
        order = np.argsort(poses.ids, kind="stable")  # as RTAB-Map has nodes and landmarks
        ids, sorted_poses = poses.ids[order].astype(np.int32), poses.map_from_node[order]
        floats = sorted_poses[:, :3].astype(np.float32)
        last = pose_to_blob(sorted_poses[-1]) if (ids > 0).any() else None
        self._db.run(
            "UPDATE Admin SET opt_ids = ?, opt_poses = ?, opt_last_localization = ?,"
            " time_enter = ?",
            (
                matrix_to_blob(ids[None]),
                matrix_to_blob(floats.reshape(1, -1)),
                last,
                self._db.entered,
            ),
        )
        self._commit()

    def poses(self) -> Poses | None:
        ids = self._read("poses ids", "i", (-1,))
        solved = self._motions("poses map_from_node")
        if ids is None or solved is None:
            return None
        covariances = self._read("poses covariances", "f", (-1, 6, 6))
        self._check_lengths("poses", ids, solved, covariances)
        return Poses(ids, solved, covariances)

    def set_frame_poses(self, map_from_frame: NDArray[np.float64]) -> None:
        self._begin()
        self._write("frame poses", map_from_frame)
        self._commit()

    def frame_poses(self) -> NDArray[np.float64] | None:
        return self._motions("frame poses")

    def _motions(self, name: str) -> NDArray[np.float64] | None:
        found = self._read(name, "f", (-1, 4, 4))
        if found is not None and not (np.abs(found) <= FARTHEST).all():
            raise MapError(f"{self.path}: {name}: a damaged array (not finite, or out of range)")
        return found

    def set_grid(self, grid: OccupancyGrid) -> None:
        self._begin()
        self._write("grid log_odds", grid.log_odds)
        figures = [grid.resolution, *grid.origin, grid.occupied_threshold, grid.free_threshold]
        self._write("grid figures", np.array(figures, np.float64))
        self._db.run(
            "UPDATE Admin SET opt_map = ?, opt_map_x_min = ?, opt_map_y_min = ?,"
            " opt_map_resolution = ?, time_enter = ?",
            (
                matrix_to_blob(grid.trinary()),
                *grid.origin.tolist(),
                grid.resolution,
                self._db.entered,
            ),
        )
        self._commit()

    def grid(self) -> OccupancyGrid | None:
        log_odds = self._read("grid log_odds", "f", (-1, -1))
        figures = self._read("grid figures", "f", (5,))
        if log_odds is None or figures is None:
            return None
        if not (np.abs(figures) <= FARTHEST).all() or figures[0] <= 0.0:
            raise MapError(f"{self.path}: grid figures: a damaged array (of no grid)")
        resolution, x, y = (float(value) for value in figures[:3])  # all grids have our thresholds
        return OccupancyGrid(log_odds, resolution, np.array([x, y]))
