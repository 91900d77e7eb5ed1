"""The shell chair: seat and back in one bent piece, on two bars with splayed legs, and spreaders between the bars.

Spreaders go between the bars along y, the bars meet the shell from below: once both bars are at the shell, no
spreader gets in. Legs go into their bars one by one, along their own axes.
"""

from __future__ import annotations

import numpy as np

from roboassembly.generate.design import Assembly, Blank, Design, family, one_of, size
from roboassembly.generate.joints import CLEARANCE, RoundTenon, Tenon, joint_frame, mouths, rail, splayed_leg
from roboassembly.generate.solids import Solid, bent, block, loft
from roboassembly.generate.vectors import Points, X, Z, leaning, move, spin, vector

MOUTH = 0.010
LEG_TENON = RoundTenon(radius=0.0115, length=0.022, end_radius=0.0105, sides=12)
LUG_PEG = Tenon(0.030, 0.014, 0.012)
SPREADER_TENON = Tenon(0.016, 0.010, 0.014)
BAR = (0.042, 0.036)  # depth and height of the bars
LUG = 0.022  # height of the lugs under the shell
ROUND = 0.085  # radius of the shell's upper corners


@family("shell", "seat and back bent from one piece, on two bars with splayed legs")
class ShellChair(Design):
    """A chair of 7 to 9 parts."""

    width: float = size(0.46, 0.43, 0.50)
    depth: float = size(0.44, 0.41, 0.46)  # of the seat
    seat_height: float = size(0.44, 0.42, 0.46)
    height: float = size(0.82, 0.76, 0.88)
    rake: float = size(0.24, 0.18, 0.30)
    bend: float = size(0.09, 0.06, 0.12)  # radius between seat and back
    shell: float = size(0.013, 0.011, 0.018)  # its thickness
    hollow: float = size(0.018, 0.0, 0.03)  # how far seat and back are dished
    splay: float = size(0.20, 0.14, 0.25)
    leg: float = size(0.017, 0.0155, 0.020)  # largest radius of a leg
    spreaders: int = one_of(0, 1, 1, 2, default=1)
    back_width: float = size(0.88, 0.72, 1.0)  # width of the back's top over that of the seat

    def build(self, a: Assembly) -> None:
        s = self
        bar_top = s.seat_height - s.shell - s.hollow - LUG
        bar_low = bar_top - BAR[1]

        # A bar along x with a leg at either end; turned about the vertical it is the other one.
        leg_x, bar_y = 0.30 * s.width, 0.26 * s.depth
        half, lug_x, inner = leg_x + 0.03, 0.62 * leg_x, bar_y - BAR[0] / 2
        bar = Blank(block((-half, -BAR[0] / 2, bar_low), (half, BAR[0] / 2, bar_top - CLEARANCE)))
        profile = [(0.12, s.leg), (0.5, 0.95 * s.leg), (1.05, 0.58 * s.leg)]
        solid, mouth_at = splayed_leg(bar_low, s.splay, LEG_TENON, MOUTH, profile)
        leg = Blank(solid)
        # On the front bar (the one at -y) both legs lean outward and forward.
        on_bar = {"right": spin(np.pi + 0.9, -leg_x), "left": spin(-0.9, leg_x)}
        for pose in on_bar.values():
            bar -= LEG_TENON.pocket(mouth_at(pose), over=MOUTH)
        for x in (-lug_x, lug_x):
            bar -= LUG_PEG.pocket(joint_frame(vector(x, 0, bar_top), Z, X))
        start, end = vector(0, -inner, bar_low + 0.014), vector(0, inner, bar_low + 0.014)
        first = -0.045 if s.spreaders == 2 else 0.0
        spreader = Blank(rail(start + first * X, end + first * X, Z, 0.026, 0.020, SPREADER_TENON))
        for k, x in enumerate(([], [0.0], [-0.045, 0.045])[s.spreaders]):
            a.part(f"spreader_{k + 1}", "bar_stretcher", spreader, move(x - first))
            bar -= SPREADER_TENON.pocket(move(x, bar_y) * mouths(start, end, Z)[0])
        a.part("bar_front", "seat_frame_bar", bar, front := move(y=-bar_y))
        a.each("leg_front", "leg", leg, {side: front * pose for side, pose in on_bar.items()})
        a.part("bar_back", "seat_frame_bar", bar, back := spin(np.pi, y=bar_y))
        a.each("leg_back", "leg", leg, {"left": back * on_bar["right"], "right": back * on_bar["left"]})

        # The shell with lugs on the bars.
        path, heading, dish, wide = self.surface()
        seat = Blank(self.shell_of(path, heading, dish, wide))
        flat = path[:, 2] < s.seat_height - s.shell / 2 + 0.010
        for x in (-lug_x, lug_x):
            for y in (-bar_y, bar_y):
                w, d, z = (float(np.interp(y, path[flat, 1], values[flat])) for values in (wide, dish, path[:, 2]))
                top = z - d * (1 - (x / w) ** 2)
                lug = block((x - 0.022, y - 0.013, bar_top), (x + 0.022, y + 0.013, top))
                seat += lug + LUG_PEG.tongue(joint_frame(vector(x, y, bar_top), Z, X))
        a.part("seat", "seat_single_surface", seat)

    def surface(self) -> tuple[Points, Points, np.ndarray, np.ndarray]:
        """Return the shell's middle line from the turned-down front edge to the top edge, and its shape along it.

        Returns points, unit tangents, how far the shell is dished there, and half its width.
        """
        front, rear = -self.depth / 2, self.depth / 2
        level = self.seat_height - self.shell / 2
        along, _ = leaning(self.rake)
        corner = vector(0, rear, level - 0.010)
        top = corner + (self.height - corner[2]) / along[2] * along
        edge = [vector(0, front - 0.012, level - 0.022), vector(0, front + 0.05, level)]
        points, tangents = bent([*edge, corner, top], self.bend, 4)
        # More stations on the straight stretches and toward the ends, for the dishing and the outline to come and go.
        path, heading = [points[0]], [tangents[0]]
        for k, (start, end, tangent) in enumerate(zip(points[:-1], points[1:], tangents[1:], strict=True)):
            far = float(np.linalg.norm(end - start))
            stops = np.linspace(0, 1, max(2, int(far // 0.10) + 1))[1:]
            if k == len(points) - 2:
                fine = 1 - np.array([0.085, 0.05, 0.025, 0.008, 0.0]) / far
                stops = np.concatenate([stops[stops < 1 - 0.09 / far], fine])
            path += [start + stop * (end - start) for stop in stops]
            heading += [tangent if len(stops) == 1 else (end - start) / far] * len(stops)
        length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
        share: np.ndarray = length / length[-1]
        dish = self.hollow * np.clip(np.minimum(share, 1 - share) / 0.22, 0, 1)
        wide = self.width / 2 * np.interp(share, [0, 0.04, 0.12, 0.5, 0.9], [0.90, 0.97, 1, 1, self.back_width])
        into_round = np.clip(1 - (length[-1] - length) / ROUND, 0, 1)
        wide -= ROUND * (1 - np.sqrt(1 - into_round**2)) * 0.9
        return np.array(path), np.array(heading), dish, wide

    def shell_of(self, path: Points, heading: Points, dish: np.ndarray, wide: np.ndarray) -> Solid:
        """Return the shell, its lower and its upper side."""
        across = np.linspace(-1, 1, 7)
        rings: list[Points] = []
        for at, tangent, w, d in zip(path, heading, wide, dish, strict=True):
            normal = np.cross(X, tangent)
            middle = at + (w * across)[:, None] * X - (d * (1 - across**2))[:, None] * normal
            half = self.shell / 2 * normal
            rings.append(np.concatenate([middle - half, (middle + half)[::-1]]))
        return loft(np.array(rings))
