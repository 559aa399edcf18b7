"""Draws the pictures of docs/simulation.md: views of a camera, worlds from above, true grids.

python benchmarks/simulation_pictures.py docs/images
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from mapmyworld.simulation import WORLDS, Recording, SimulationSettings, simulate
from mapmyworld.simulation.simulated_camera import Renderer
from mapmyworld.simulation.world import build_scene

Picture = NDArray[np.uint8]
RED = (60, 60, 230)


def camera_picture(recording: Recording, seconds: float) -> Picture:
    """Colour and depth side by side, as recorded."""
    stream = recording.streams[-1]  # the camera's
    index = int(np.searchsorted(stream.schedule.times, seconds))
    (_, _), (_, colour), (_, depth) = stream.messages(index)
    bgr = cv2.cvtColor(colour.pixels(), cv2.COLOR_RGB2BGR)
    metres = depth.pixels()
    shade = np.clip(metres / 8.0 * 255.0, 0, 255).astype(np.uint8)
    tinted = cv2.applyColorMap(shade, cv2.COLORMAP_TURBO)
    tinted[metres == 0] = 0
    return np.hstack([bgr, tinted])


def from_above(name: str, recording: Recording) -> Picture:
    """The world without its ceilings, seen from high up, and the robot's path."""
    world = WORLDS[name]
    open_world = replace(world, grounds=tuple(replace(g, ceiling="") for g in world.grounds))
    boxes = np.array([g.extent for g in world.grounds])
    low, high = boxes[:, :2].min(0), boxes[:, 2:].max(0)
    middle, size = (low + high) / 2.0, float((high - low).max())
    settings = SimulationSettings()
    height = 3.0 * size
    angle = 2.0 * np.degrees(np.arctan(0.54 * size / height))
    eye = replace(settings.camera, width=900, height=700, field_of_view=angle)
    settings = replace(settings, camera=eye)
    looking_down = np.array(
        [[1.0, 0, 0, middle[0]], [0, -1.0, 0, middle[1]], [0, 0, -1.0, height], [0, 0, 0, 1.0]]
    )
    view = Renderer(build_scene(open_world), settings).render(looking_down)
    picture = cv2.cvtColor(view.colour, cv2.COLOR_RGB2BGR)
    focal = 450.0 / np.tan(np.radians(angle) / 2.0)
    path = (recording.truth.drive.poses[::20, :2] - middle) * [1.0, -1.0] * focal / height
    line = np.round(np.array([449.5, 349.5]) + path).astype(np.int32)
    cv2.polylines(picture, [line], False, RED, 2, cv2.LINE_AA)
    rows = np.flatnonzero((picture != picture[0, 0]).any(axis=(1, 2)))
    return picture[max(rows[0] - 8, 0) : rows[-1] + 8]


def grid_picture(recording: Recording) -> Picture:
    """The true grid, north up: white free, black occupied, grey unknown."""
    cells = recording.truth.grid.trinary()[::-1]
    grey = np.choose(cells.astype(int) // 50 + 1, [205, 254, 0, 0]).astype(np.uint8)
    grey[cells == -1] = 205
    scale = max(1, 900 // grey.shape[1])
    return np.kron(grey, np.ones((scale, scale), np.uint8))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    blind = replace(
        SimulationSettings(), camera=replace(SimulationSettings().camera, enabled=False)
    )
    flat = simulate("apartment", laps=1)
    pictures = {
        "simulation_camera": camera_picture(flat, 3.0),
        "simulation_apartment": from_above("apartment", flat),
        "simulation_apartment_grid": grid_picture(flat),
        "simulation_hall_camera": camera_picture(simulate("hall", laps=1), 12.0),
    }
    for name in ("hall", "office"):
        pictures[f"simulation_{name}"] = from_above(name, simulate(name, settings=blind, laps=1))
    for name, picture in pictures.items():
        small = cv2.resize(picture, None, fx=0.6, fy=0.6, interpolation=cv2.INTER_AREA)
        cv2.imwrite(str(folder / f"{name}.png"), small, [cv2.IMWRITE_PNG_COMPRESSION, 9])
        print(folder / f"{name}.png")


if __name__ == "__main__":
    main()
