"""The arm in MuJoCo: rigid discs on joints with springs, bellows as tendons that push."""

import mujoco
import numpy as np

from arm import GRAVITY_M_S2, Arm

NAME = "MuJoCo"
VERSION = mujoco.__version__

# Warnings are counted in the data (see `failed`); without this they go to a file beside the user.
mujoco.set_mju_user_warning(lambda _text: None)


class Simulation:
    """One disc per element. Each element bends in its middle (three hinges) and stretches (one slide),
    in turn above and below the hinges, so that neighbours make up for each other.

    The bellows' elasticity is in the joints; their pressure is a force on tendons that run through
    the discs, so it follows the bellows' path. Damping is `damping_s` times each joint's stiffness,
    1.4 times that for twist.
    """

    def __init__(self, arm: Arm, elements: int, step_s: float, damping_s: float):
        xml = _xml(arm, elements, step_s, damping_s)
        self.arm = arm
        self.step_s = step_s
        self.model = mujoco.MjModel.from_xml_string(xml)
        self.data = mujoco.MjData(self.model)
        self.tip = self.model.body("end").id
        self.unknowns = self.model.nv

    def start(self, pressures_kpa) -> None:
        """The unloaded arm at rest, the pressures applied at once."""
        mujoco.mj_resetData(self.model, self.data)
        self.data.ctrl[:] = self.arm.push_n(pressures_kpa).ravel()

    def run(self, steps: int) -> None:
        """So many steps, in one call."""
        mujoco.mj_step(self.model, self.data, nstep=steps)

    def tip_m(self) -> np.ndarray:
        """Origin of the end pad."""
        mujoco.mj_kinematics(self.model, self.data)
        return self.data.xpos[self.tip].copy()

    def failed(self) -> bool:
        """Whether MuJoCo has given up and started over since `start`."""
        return any(self.data.warning[w].number > 0 for w in range(len(self.data.warning)))


def _xml(arm: Arm, n: int, step_s: float, damping_s: float) -> str:
    length = arm.length_m / n
    # Stiffness of one element.
    axial, bending, torsion = (x / length for x in (arm.axial_n, arm.bending_nm2, arm.torsion_nm2))

    def joint(kind: str, axis: str, z: float, k: float, damping: float = damping_s) -> str:
        return (
            f'<joint type="{kind}" axis="{axis}" pos="0 0 {z:.9g}" '
            f'stiffness="{k:.9g}" damping="{damping * k:.9g}"/>'
        )

    slide = joint("slide", "0 0 -1", 0.0, axial)
    hinges = (
        joint("hinge", "1 0 0", 0.5 * length, bending)
        + joint("hinge", "0 1 0", 0.5 * length, bending)
        # Tendons under tension stiffen a short arm against twist, to about twice the joint's own.
        + joint("hinge", "0 0 1", 0.5 * length, torsion, 1.4 * damping_s)
    )

    def site(name: str, xy, z: float) -> str:
        return f'<site name="{name}" pos="{xy[0]:.9g} {xy[1]:.9g} {z:.9g}"/>'

    def row(prefix: str, points, z: float) -> str:
        return "".join(site(f"{prefix}{i}", p, z) for i, p in enumerate(points))

    lump = arm.segment_kg / n
    ring = (lump, arm.circle_m)
    world = row("t0_0_", arm.bellows_m[0], 0.0) + row("top0_", arm.spring_top_m[0], 0.0)
    opened, closed = "", ""
    for s in range(2):
        for e in range(1, n + 1):
            last = e == n
            drop = length + (arm.pad_m if s == 1 and e == 1 else 0.0)
            name = ("middle", "end")[s] if last else f"s{s}e{e}"
            inside = row(f"t{s}_{e}_", arm.bellows_m[s], 0.0)
            # (mass, z, radius of a ring or disc, moment of inertia about z over m r²)
            bodies = [(ring[0] * (0.5 if last else 1.0), 0.0, ring[1], 1.0)]
            if last and s == 0:
                inside += row("bottom0_", arm.spring_bottom_m[0], 0.0)
                inside += row("t1_0_", arm.bellows_m[1], -arm.pad_m)
                inside += row("top1_", arm.spring_top_m[1], -arm.pad_m)
                bodies += [
                    (0.5 * lump, -arm.pad_m, arm.circle_m, 1.0),
                    (arm.middle_pad_kg, -0.5 * arm.pad_m, arm.spring_circle_m, 0.5),
                ]
            elif last:
                inside += row("bottom1_", arm.spring_bottom_m[1], 0.0)
                bodies += [
                    (arm.end_pad_kg, -0.5 * arm.pad_m, arm.spring_circle_m, 0.5),
                    (arm.gripper_kg, -arm.gripper_com_m, 0.5 * arm.spring_circle_m, 0.5),
                ]
            joints = slide + hinges if e % 2 == 1 else hinges + slide
            opened += f'<body name="{name}" pos="0 0 {-drop:.9g}">{_inertial(bodies)}{joints}{inside}'
            closed += "</body>"
    tendons, motors = "", ""
    for s in range(2):
        for i in range(3):
            path = "".join(f'<site site="t{s}_{e}_{i}"/>' for e in range(n + 1))
            tendons += f'<spatial name="b{s}_{i}">{path}</spatial>'
            motors += f'<motor tendon="b{s}_{i}" gear="1"/>'
        for i in range(6):
            # A spring that only pulls: no force between 0 and its free length.
            tendons += (
                f'<spatial stiffness="{arm.spring_rate_n_m}" springlength="0 {arm.spring_free_m}">'
                f'<site site="top{s}_{i}"/><site site="bottom{s}_{i}"/></spatial>'
            )
    return (
        f'<mujoco><compiler angle="radian"/>'
        f'<option timestep="{step_s}" integrator="implicitfast" gravity="0 0 {-GRAVITY_M_S2}">'
        f'<flag contact="disable" constraint="disable"/></option>'
        f"<worldbody>{world}{opened}{closed}</worldbody>"
        f"<tendon>{tendons}</tendon><actuator>{motors}</actuator></mujoco>"
    )


def _inertial(bodies) -> str:
    kg = sum(b[0] for b in bodies)
    com = sum(b[0] * b[1] for b in bodies) / kg
    about_z = sum(m * f * r * r for m, _, r, f in bodies)
    across = 0.5 * about_z + sum(m * (z - com) ** 2 for m, z, _, _ in bodies)
    return (
        f'<inertial pos="0 0 {com:.9g}" mass="{kg:.9g}" '
        f'diaginertia="{across:.9g} {across:.9g} {about_z:.9g}"/>'
    )
