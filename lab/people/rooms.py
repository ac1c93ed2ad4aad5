"""The rooms: floor, walls, things and light. Room axes: x toward the camera, y to the right in the picture, z up."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from lab.people.surface import Array


@dataclass(frozen=True, kw_only=True, slots=True)
class Room:
    """A room as MJCF pieces and the textures they use."""

    geoms: str
    assets: str
    files: dict[str, bytes]
    key: tuple[float, float, float]
    """Where the main light shines to, room axes."""
    warmth: tuple[float, float, float] = (1.0, 0.97, 0.92)


def gym() -> Room:
    """Boxing gym: brick wall, dark wooden panel, heavy bag, ring ropes, mats."""
    files = {
        "wall.png": _png(np.rot90(_bricks((158, 104, 86), (186, 174, 160), 7))),
        "floor.png": _png(_planks((128, 92, 64), 3)),
    }
    assets = _texture("wall", 2.8) + _texture("floor", 3.0)
    geoms = [
        _plane("floor", (0, 0, 0), "0 0 0", (6, 6)),
        _plane("wall", (-2.50, 0, 1.5), "0 90 0", (3, 6)),
        _box((-2.48, 0, 0.06), (0.03, 6, 0.06), (0.20, 0.17, 0.16)),
        _box((-0.2, 0, 0.004), (1.35, 1.75, 0.004), (0.20, 0.27, 0.36)),
        _box((-0.2, 0, 0.0045), (1.27, 1.67, 0.004), (0.25, 0.33, 0.43)),
    ]
    for z, tint in ((0.62, (0.80, 0.16, 0.14)), (0.98, (0.92, 0.91, 0.88)), (1.34, (0.18, 0.30, 0.62))):
        geoms.append(_tube((-1.75, -3.5, z), (-1.75, 3.5, z), 0.020, tint))
    for y in (-1.72, 2.45):
        geoms.append(_tube((-1.85, y, 0.0), (-1.85, y, 1.52), 0.05, (0.16, 0.16, 0.18)))
        geoms.append(_box((-1.79, y, 0.98), (0.05, 0.075, 0.44), (0.80, 0.16, 0.14)))
    bag = (-1.05, -1.30)
    geoms += [
        _cylinder((*bag, 1.15), 0.175, 0.52, (0.42, 0.10, 0.09)),
        _cylinder((*bag, 1.46), 0.179, 0.035, (0.90, 0.88, 0.84)),
        _cylinder((*bag, 0.84), 0.179, 0.035, (0.90, 0.88, 0.84)),
        _geom(f'type="ellipsoid" pos="{bag[0]} {bag[1]} 0.63" size="0.175 0.175 0.05"', (0.36, 0.08, 0.08)),
        _tube((bag[0] - 0.10, bag[1], 1.66), (bag[0], bag[1], 2.0), 0.010, (0.6, 0.6, 0.62)),
        _tube((bag[0] + 0.10, bag[1], 1.66), (bag[0], bag[1], 2.0), 0.010, (0.6, 0.6, 0.62)),
        _tube((*bag, 2.0), (*bag, 3.2), 0.012, (0.6, 0.6, 0.62)),
    ]
    geoms += [
        _box((-2.48, 1.55, 2.02), (0.02, 0.50, 0.32), (0.12, 0.12, 0.13)),
        _box((-2.46, 1.55, 2.02), (0.02, 0.47, 0.29), (0.91, 0.86, 0.74)),
        _geom('type="ellipsoid" pos="-2.44 1.44 2.03" size="0.012 0.13 0.15"', (0.75, 0.10, 0.10)),
        _geom('type="ellipsoid" pos="-2.44 1.68 2.03" size="0.012 0.13 0.15"', (0.16, 0.28, 0.60)),
    ]
    return Room(geoms="\n".join(geoms), assets=assets, files=files, key=(-0.52, 0.40, -0.88))


def studio() -> Room:
    """Ballet studio: tall windows with a pale sky, a barre, a light floor."""
    files = {
        "wall.png": _png(_plaster((226, 214, 206), 5)),
        "floor.png": _png(_planks((196, 158, 118), 11)),
        "sky.png": _png(_sky()),
    }
    assets = _texture("wall", 4.0) + _texture("floor", 2.6) + _texture("sky", 1.0, spread=True)
    geoms = [
        _plane("floor", (0, 0, 0), "0 0 0", (6, 6)),
        _plane("wall", (-2.20, 0, 1.5), "0 90 0", (3, 6)),
        _box((-2.19, 0, 0.07), (0.03, 6, 0.07), (0.95, 0.93, 0.90)),
    ]
    for y in (-1.95, 1.95):
        geoms.append(_box((-2.20, y, 1.70), (0.02, 0.62, 1.30), (0.96, 0.95, 0.93)))
        geoms.append(_box((-2.17, y, 1.70), (0.015, 0.56, 1.24), material="sky"))
        for z in (1.15, 1.75, 2.35):
            geoms.append(_box((-2.15, y, z), (0.012, 0.56, 0.014), (0.96, 0.95, 0.93)))
        geoms.append(_box((-2.15, y, 1.70), (0.012, 0.014, 1.24), (0.96, 0.95, 0.93)))
        geoms.append(_box((-2.13, y, 0.38), (0.08, 0.68, 0.02), (0.97, 0.96, 0.94)))
    for z in (0.82, 1.04):
        geoms.append(_tube((-1.92, -3.4, z), (-1.92, 3.4, z), 0.022, (0.70, 0.48, 0.30)))
    for y in (-2.75, -0.95, 0.95, 2.75):
        geoms.append(_tube((-1.92, y, 0.0), (-1.92, y, 1.04), 0.014, (0.80, 0.78, 0.74)))
    return Room(geoms="\n".join(geoms), assets=assets, files=files, key=(-0.60, -0.50, -0.85))


def lounge() -> Room:
    """Living room: a warm wall, shelf with books, lamp, plant, rug."""
    files = {
        "wall.png": _png(_plaster((214, 190, 160), 9)),
        "floor.png": _png(_planks((150, 108, 74), 17)),
        "art.png": _png(_art()),
    }
    assets = _texture("wall", 4.0) + _texture("floor", 2.4) + _texture("art", 1.0, spread=True)
    geoms = [
        _plane("floor", (0, 0, 0), "0 0 0", (6, 6)),
        _plane("wall", (-1.90, 0, 1.5), "0 90 0", (3, 6)),
        _box((-1.89, 0, 0.06), (0.03, 6, 0.06), (0.94, 0.91, 0.86)),
        _cylinder((0, 0, 0.003), 1.34, 0.003, (0.36, 0.46, 0.48)),
        _cylinder((0, 0, 0.004), 1.26, 0.003, (0.84, 0.80, 0.71)),
        _cylinder((0, 0, 0.005), 1.18, 0.003, (0.42, 0.53, 0.54)),
        _box((-1.88, -1.50, 1.86), (0.02, 0.44, 0.34), (0.22, 0.16, 0.12)),
        _box((-1.86, -1.50, 1.86), (0.02, 0.40, 0.30), material="art"),
    ]
    geoms += [
        _box((-1.62, -1.50, 0.40), (0.20, 0.62, 0.36), (0.52, 0.34, 0.22)),
        _box((-1.60, -1.50, 0.77), (0.22, 0.65, 0.018), (0.60, 0.41, 0.27)),
        _box((-1.41, -1.80, 0.40), (0.012, 0.29, 0.32), (0.58, 0.39, 0.26)),
        _box((-1.41, -1.19, 0.40), (0.012, 0.29, 0.32), (0.58, 0.39, 0.26)),
    ]
    rng = np.random.default_rng(4)
    y = -2.05
    for tint in ((0.70, 0.25, 0.20), (0.90, 0.80, 0.60), (0.20, 0.36, 0.42), (0.82, 0.56, 0.24), (0.30, 0.30, 0.34)):
        half, tall = 0.014 + 0.012 * rng.random(), 0.10 + 0.05 * rng.random()
        y += half
        geoms.append(_box((-1.62, y, 0.788 + tall), (0.09, half, tall), tint))
        y += half + 0.002
    geoms += [
        _cylinder((-1.58, -1.08, 0.80), 0.07, 0.012, (0.80, 0.66, 0.42)),
        _cylinder((-1.58, -1.08, 0.93), 0.012, 0.13, (0.80, 0.66, 0.42)),
        '<geom type="cylinder" pos="-1.58 -1.08 1.12" size="0.13 0.10" material="glow"/>',
        _cylinder((-1.35, 1.62, 0.20), 0.19, 0.20, (0.90, 0.87, 0.82)),
        _cylinder((-1.35, 1.62, 0.405), 0.17, 0.008, (0.22, 0.15, 0.10)),
    ]
    for i in range(15):
        turn, lean, tall = 2.4 * i, 0.25 + 0.55 * rng.random(), 0.55 + 0.45 * rng.random()
        side, up = np.sin(lean) * np.array([np.cos(turn), np.sin(turn)]), np.cos(lean)
        tip = np.array([-1.35 + tall * side[0], 1.62 + tall * side[1], 0.40 + tall * up])
        geoms.append(_tube((-1.35, 1.62, 0.40), tuple(tip), 0.008, (0.24, 0.40, 0.18)))
        green = (0.16 + 0.12 * rng.random(), 0.42 + 0.16 * rng.random(), 0.20)
        lift = np.rad2deg(np.arctan2(up, np.sin(lean)))
        geoms.append(
            f'<geom type="ellipsoid" pos="{_text(tip)}" size="0.17 0.065 0.012" euler="0 {-lift + 25:.1f} '
            f'{np.rad2deg(turn):.1f}" rgba="{_text(green)} 1"/>'
        )
    assets += '<material name="glow" rgba="1 0.90 0.68 1" emission="0.75"/>'
    return Room(geoms="\n".join(geoms), assets=assets, files=files, key=(-0.66, 0.44, -0.80))


def _text(values: Array | tuple[float, ...]) -> str:
    return " ".join(f"{v:.5g}" for v in values)


def _geom(shape: str, colour: tuple[float, ...]) -> str:
    return f'<geom {shape} rgba="{_text(colour)} 1"/>'


def _box(
    at: tuple[float, ...], half: tuple[float, ...], colour: tuple[float, ...] = (1, 1, 1), material: str = ""
) -> str:
    paint = f'material="{material}"' if material else f'rgba="{_text(colour)} 1"'
    return f'<geom type="box" pos="{_text(at)}" size="{_text(half)}" {paint}/>'


def _plane(material: str, at: tuple[float, ...], euler: str, half: tuple[float, float]) -> str:
    return f'<geom type="plane" pos="{_text(at)}" euler="{euler}" size="{_text(half)} 0.1" material="{material}"/>'


def _cylinder(at: tuple[float, ...], radius: float, half: float, colour: tuple[float, ...]) -> str:
    return _geom(f'type="cylinder" pos="{_text(at)}" size="{radius} {half}"', colour)


def _tube(a: tuple[float, ...], b: tuple[float, ...], radius: float, colour: tuple[float, ...]) -> str:
    return _geom(f'type="capsule" fromto="{_text((*a, *b))}" size="{radius}"', colour)


def _texture(name: str, metres: float, spread: bool = False) -> str:
    """A texture file as a material that repeats every so many metres, or is spread over the whole shape once."""
    repeat = 2.0 / metres
    kind = f'texuniform="true" texrepeat="{repeat:.4f} {repeat:.4f}"'
    if spread:
        kind = 'texuniform="false" texrepeat="1 1"'
    light = 'emission="0.25"' if name == "sky" else 'specular="0.12" shininess="0.2"'
    return (
        f'<texture name="{name}" type="2d" file="{name}.png"/><material name="{name}" texture="{name}" {kind} {light}/>'
    )


def _png(rgb: Array) -> bytes:
    picture = np.clip(rgb, 0, 255).astype(np.uint8)
    return cv2.imencode(".png", picture[:, :, ::-1])[1].tobytes()


def _clouds(size: int, seed: int, octaves: int = 5) -> Array:
    """Smooth random pattern that repeats at the edges, about -1 to 1."""
    rng = np.random.default_rng(seed)
    total = np.zeros((size, size))
    for i in range(octaves):
        cells = 4 * 2**i
        grid = np.tile(rng.uniform(-1, 1, (cells, cells)), (3, 3))
        wide = np.asarray(cv2.resize(grid, (3 * size, 3 * size), interpolation=cv2.INTER_CUBIC), float)
        total += wide[size : 2 * size, size : 2 * size] / 1.6**i
    return np.asarray(total / 1.6, float)


def _planks(colour: tuple[int, int, int], seed: int) -> Array:
    rng = np.random.default_rng(seed)
    size, rows = 1024, 16
    picture = np.empty((size, size, 3))
    high = size // rows
    grain = _clouds(size, seed)
    for row in range(rows):
        shift, length = int(rng.integers(size)), size // 2
        for part in range(2):
            tone = 1.0 + 0.13 * rng.uniform(-1, 1)
            roll = int(rng.integers(size))
            fibre = cv2.resize(np.roll(grain, roll, 0)[: high // 1, ::4], (length, high))
            block = np.array(colour) * (tone + 0.09 * fibre[:, :, None])
            block[:2] *= 0.62
            block[:, :3] *= 0.66
            columns = (np.arange(length) + shift + part * length) % size
            picture[row * high : (row + 1) * high, columns] = block
    return picture


def _bricks(colour: tuple[int, int, int], mortar: tuple[int, int, int], seed: int) -> Array:
    rng = np.random.default_rng(seed)
    size, rows, columns = 1024, 32, 12
    noise = _clouds(size, seed)
    picture = np.array(mortar) * (0.86 + 0.05 * noise[:, :, None])
    high, wide = size / rows, size / columns
    for row in range(rows):
        for column in range(columns):
            tone = 1.0 + 0.16 * rng.uniform(-1, 1)
            tint = np.array(colour) * tone + rng.uniform(-7, 7, 3)
            x0 = int((column + 0.5 * (row % 2)) * wide) + 3
            ys = np.arange(int(row * high) + 3, int((row + 1) * high))
            xs = np.arange(x0, x0 + int(wide) - 4) % size
            picture[np.ix_(ys, xs)] = tint * (0.93 + 0.10 * noise[np.ix_(ys, xs)][:, :, None])
    return np.asarray(cv2.GaussianBlur(picture, (3, 3), 0), float)


def _plaster(colour: tuple[int, int, int], seed: int) -> Array:
    return np.asarray(colour, float) * (1.0 + 0.025 * _clouds(512, seed)[:, :, None])


def _sky() -> Array:
    size = 512
    height = np.linspace(0, 1, size)[:, None, None]
    sky = (1 - height) * np.array([186, 214, 240]) + height * np.array([250, 240, 226])
    clouds = np.clip(_clouds(size, 21) + 0.1, 0, 1)[:, :, None]
    return np.asarray(sky + 0.5 * clouds * (255 - sky), float)


def _art() -> Array:
    """Hills under an evening sun."""
    size = 512
    y, x = np.mgrid[0:size, 0:size] / size
    picture = (1 - y)[:, :, None] * np.array([70, 110, 140]) + y[:, :, None] * np.array([250, 200, 140])
    picture[(x - 0.66) ** 2 + (y - 0.42) ** 2 < 0.012] = (252, 226, 160)
    for level, tint in ((0.58, (190, 120, 90)), (0.70, (130, 84, 82)), (0.84, (62, 56, 72))):
        picture[y > level + 0.06 * np.sin(7 * x + 9 * level) + 0.03 * np.sin(17 * x)] = tint
    return picture
