"""The reference robot's numbers, read from its own file, in SI units."""

import math
import tomllib
from dataclasses import dataclass

import numpy as np

GRAVITY_M_S2 = 9.80665  # the same as the program's


@dataclass
class Arm:
    """Two segments of three bellows each; arrays are indexed by segment first."""

    bellows_m: np.ndarray  # (2, 3, 2): centre of each bellows in the cross-section
    spring_top_m: np.ndarray  # (2, 6, 2)
    spring_bottom_m: np.ndarray  # (2, 6, 2)
    spring_rate_n_m: float
    spring_free_m: float
    length_m: float  # of a segment, at 0 Pa
    pad_m: float  # thickness
    area_m2: float  # effective, of one chamber
    axial_n: float  # rigidity of a segment against stretch, three bellows
    bending_nm2: float  # bellows' share and the rest
    torsion_nm2: float
    circle_m: float  # radius of the bellows circle
    spring_circle_m: float
    segment_kg: float  # three bellows
    middle_pad_kg: float
    end_pad_kg: float
    gripper_kg: float
    gripper_com_m: float
    pressure_kpa: tuple[float, float]

    def push_n(self, pressures_kpa) -> np.ndarray:
        """p A of every chamber, (2, 3)."""
        return np.asarray(pressures_kpa, float).reshape(2, 3) * 1e3 * self.area_m2


def read(path) -> Arm:
    """The arm of a robot file."""
    with open(path, "rb") as f:
        t = tomllib.load(f)
    length_m = t["bellows"]["rest_length_mm"] * 1e-3
    axial_n_m = t["bellows"]["axial_stiffness_n_m"]
    circle_m = t["base"]["bellows_circle_radius_mm"] * 1e-3
    spring_circle_m = t["springs"]["attachment_radius_mm"] * 1e-3
    angles = np.radians(t["base"]["bellows_angles_deg"]).reshape(2, 3)
    tops, bottoms = [], []
    for segment in angles:
        for pair in np.radians(t["springs"]["pair_angles_deg"]):
            # Spring A runs from one side of the pair's angle to the other, spring B the reverse.
            for sign in (-1.0, 1.0):
                spread = sign * math.radians(t["springs"]["half_spread_deg"])
                tops.append(segment[0] + pair + spread)
                bottoms.append(segment[0] + pair - spread)
    on_circle = lambda a, r: r * np.stack([np.cos(a), np.sin(a)], axis=-1)
    # The three bellows stand evenly on their circle: sum of x^2 is 3/2 r^2 about every axis.
    bending_nm_rad = t["segment"]["bending_stiffness_nm_rad"] + 1.5 * axial_n_m * circle_m**2
    return Arm(
        bellows_m=on_circle(angles, circle_m),
        spring_top_m=on_circle(np.array(tops).reshape(2, 6), spring_circle_m),
        spring_bottom_m=on_circle(np.array(bottoms).reshape(2, 6), spring_circle_m),
        spring_rate_n_m=t["springs"]["rate_n_m"],
        spring_free_m=t["springs"]["free_length_mm"] * 1e-3,
        length_m=length_m,
        pad_m=t["base"]["pad_thickness_mm"] * 1e-3,
        area_m2=math.pi / 4 * (t["bellows"]["effective_diameter_mm"] * 1e-3) ** 2,
        axial_n=3 * axial_n_m * length_m,
        bending_nm2=bending_nm_rad * length_m,
        torsion_nm2=t["segment"]["torsional_stiffness_nm_rad"] * length_m,
        circle_m=circle_m,
        spring_circle_m=spring_circle_m,
        segment_kg=3 * t["mass"]["bellows_kg"],
        middle_pad_kg=t["mass"]["middle_pad_kg"],
        end_pad_kg=t["mass"]["end_pad_kg"],
        gripper_kg=t["mass"]["gripper_kg"],
        gripper_com_m=t["mass"]["gripper_com_mm"] * 1e-3,
        pressure_kpa=tuple(t["pressure"]["range_kpa"]),
    )
