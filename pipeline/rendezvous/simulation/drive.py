"""Physics of the robots: commands in, true poses and encoder readings out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from rendezvous.errors import require_within
from rendezvous.floorplan.records import Shape, Solid
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.simulation.headless_mujoco import mujoco
from rendezvous.simulation.robot import CONTROL_HZ, RobotSpec
from rendezvous.simulation.world import SLOT_Z_M, TIMESTEP_S, Drive, collision_masks, scene_mjcf

CELL_M = 0.25

_PARKED = (-1,)


class Nearby:
    """The solids within reach of each cell of a grid over the floor.

    A solid is near a cell if it is within `reach_m` of one of its points.
    """

    def __init__(self, solids: Sequence[Solid], *, reach_m: float) -> None:
        self._near: dict[tuple[int, int], list[int]] = {}
        for index, solid in enumerate(solids):
            for cell in _cells_near(solid, reach_m):
                self._near.setdefault(cell, []).append(index)
        self.most = max((len(near) for near in self._near.values()), default=0)
        """The largest number of solids near one cell."""

    def solids_at(self, poses_w: Array) -> tuple[int, ...]:
        """Indices, ascending, of the solids near any of the points (R, 2 or more) [m]."""
        near: set[int] = set()
        for x_m, y_m in poses_w[:, :2].tolist():
            near.update(self._near.get((math.floor(y_m / CELL_M), math.floor(x_m / CELL_M)), ()))
        return tuple(sorted(near))


def _cells_near(solid: Solid, reach_m: float) -> list[tuple[int, int]]:
    """Cells whose centre is within reach, and half a cell's diagonal, of the footprint."""
    corners_m = solid.corners_m()
    margin_m = reach_m + CELL_M
    col0, row0 = np.floor((corners_m.min(axis=0) - margin_m) / CELL_M).astype(int)
    col1, row1 = np.floor((corners_m.max(axis=0) + margin_m) / CELL_M).astype(int)
    rows, cols = np.mgrid[row0 : row1 + 1, col0 : col1 + 1]
    centres_m = np.stack([(cols + 0.5) * CELL_M, (rows + 0.5) * CELL_M], axis=-1)
    outside_m = np.abs(solid.T_w_s().inverse() @ centres_m) - (solid.half_x_m, solid.half_y_m)
    near = np.hypot(*np.moveaxis(np.maximum(outside_m, 0.0), -1, 0)) <= reach_m + CELL_M * math.sqrt(0.5)
    return list(zip(rows[near].tolist(), cols[near].tolist(), strict=True))


class Slots:
    """The geoms `slot0`, `slot1`, ... of a model, which can take the place of solids."""

    def __init__(self, model: Any, solids: Sequence[Solid], only_for: Sequence[int | None] = ()) -> None:
        self._model = model
        self._solids = solids
        self._masks = [collision_masks(robot) for robot in only_for]
        names = [model.geom(geom).name for geom in range(model.ngeom)]
        self._geoms = [geom for geom, name in enumerate(names) if name.startswith("slot")]
        self._filled: tuple[int, ...] = _PARKED
        # The tree of bounding boxes is built once, around the parked slots.
        if self._geoms:
            model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_MIDPHASE

    def fill(self, indices: tuple[int, ...]) -> None:
        """Put just these solids into the scene."""
        if indices == self._filled:
            return
        self._filled = indices
        for slot, geom in enumerate(self._geoms):
            if slot < len(indices):
                self._place(geom, self._solids[indices[slot]])
                if self._masks:
                    masks = self._masks[indices[slot]]
                    self._model.geom_contype[geom], self._model.geom_conaffinity[geom] = masks
            else:
                self._model.geom_pos[geom] = (0.0, 0.0, SLOT_Z_M)

    def _place(self, geom: int, solid: Solid) -> None:
        model, half_z_m = self._model, 0.5 * (solid.z1_m - solid.z0_m)
        is_box = solid.shape is Shape.BOX
        model.geom_type[geom] = mujoco.mjtGeom.mjGEOM_BOX if is_box else mujoco.mjtGeom.mjGEOM_CYLINDER
        half_m = (solid.half_x_m, solid.half_y_m, half_z_m)
        model.geom_size[geom] = half_m if is_box else (solid.half_x_m, half_z_m, 0.0)
        model.geom_pos[geom] = (solid.x_m, solid.y_m, solid.z0_m + half_z_m)
        model.geom_quat[geom] = (math.cos(0.5 * solid.yaw_rad), 0.0, 0.0, math.sin(0.5 * solid.yaw_rad))
        model.geom_aabb[geom] = (0.0, 0.0, 0.0, *half_m)
        model.geom_rbound[geom] = math.hypot(*half_m) if is_box else math.hypot(solid.half_x_m, half_z_m)
        # The compiler marks geoms whose frame is their body's; that no longer holds.
        model.geom_sameframe[geom] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE


TICK_S = 1.0 / CONTROL_HZ  # period of the wheel controller and of the encoders


@dataclass(frozen=True, slots=True, kw_only=True)
class OdometryNoise:
    """Errors of the encoders, on top of the slip that physics gives."""

    scale_sigma: float = 0.002  # sigma of each wheel's constant scale error (wear, tyre, calibration)
    tick_rad: float = 2.0 * math.pi / 4096  # size of an encoder step (XL430: 4096 steps a turn)
    jitter_rad: float = 0.001  # sigma of each reading
    # Sigma of the relative slip of each wheel and tick under `planar` drive, where there are no wheels to
    # slip.
    planar_slip: float = 0.02

    def __post_init__(self) -> None:
        require_within(
            self, scale_sigma=(0, 0.2), tick_rad=(1e-6, 1), jitter_rad=(0, 0.5), planar_slip=(0, 0.5)
        )


_DIVERGED = (
    mujoco.mjtWarning.mjWARN_BADQPOS,
    mujoco.mjtWarning.mjWARN_BADQVEL,
    mujoco.mjtWarning.mjWARN_BADQACC,
    mujoco.mjtWarning.mjWARN_BADCTRL,
)

# Otherwise MuJoCo would write a log file into the working directory; every step checks for warnings.
mujoco.set_mju_user_warning(lambda message: None)


class Encoder:
    """The two wheel encoders of one robot."""

    def __init__(self, noise: OdometryNoise, *, rng: np.random.Generator) -> None:
        self._noise = noise
        self._rng = rng
        # Normal: one constant scale error per wheel and episode.
        self._scale = 1.0 + noise.scale_sigma * rng.standard_normal(2)

    def read(self, wheels_rad: tuple[float, float]) -> tuple[float, float]:
        """Left and right wheel angle [rad] as the encoders report them."""
        # Normal jitter of each reading, then steps.
        jitter = self._rng.standard_normal(2)
        noise = self._noise
        left = wheels_rad[0] * self._scale[0] + noise.jitter_rad * jitter[0]
        right = wheels_rad[1] * self._scale[1] + noise.jitter_rad * jitter[1]
        return (
            math.floor(left / noise.tick_rad) * noise.tick_rad,
            math.floor(right / noise.tick_rad) * noise.tick_rad,
        )


class Physics:
    """MuJoCo, stepped one controller period at a time.

    MuJoCo looks at every geom in every step, static ones included, which takes two fifths of the time in a
    furnished plan. So its scene holds only the solids within a robot's reach, in slots that are refilled as
    the robots move on; the motion is the same.

    Starts are poses in w. `planar_slip` is relative, per tick, see `OdometryNoise`; `all_solids` keeps all
    solids in the scene all the time. Where robots have worlds of their own, `only_for` says of each solid
    which robot alone runs into it, None for all.
    """

    def __init__(
        self,
        solids: Sequence[Solid],
        robots: Sequence[RobotSpec],
        starts: Sequence[SE2],
        *,
        drive: Drive,
        planar_slip: float,
        rng: np.random.Generator,
        all_solids: bool = False,
        only_for: Sequence[int | None] = (),
    ) -> None:
        reach_m = max(max(spec.size_m) + 2.0 * spec.max_speed_mps * TICK_S for spec in robots)
        self._nearby = None if all_solids else Nearby(solids, reach_m=reach_m)
        mjcf = scene_mjcf(
            solids if self._nearby is None else (),
            robots,
            starts,
            drive=drive,
            slots=0 if self._nearby is None else len(robots) * self._nearby.most,
            own_worlds=bool(only_for),
        )
        self._model = mujoco.MjModel.from_xml_string(mjcf)
        # After divergence MuJoCo would reset everything and go on.
        self._model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self._slots = Slots(self._model, solids, only_for)
        self._data = mujoco.MjData(self._model)
        self._robots = robots
        self._drive = drive
        self._slip = planar_slip
        self._rng = rng
        self._substeps = round(TICK_S / TIMESTEP_S[drive])
        first_joint = "{}" if drive is Drive.WHEELS else "{}_x"
        self._qpos = [
            int(self._model.joint(first_joint.format(f"r{i}")).qposadr[0]) for i in range(len(robots))
        ]
        self._starts_w = np.array([start.as_array() for start in starts])
        self._poses_w = self._starts_w.copy()
        self._wheels_rad = np.zeros((len(robots), 2))
        self._ticks = 0

    def step(self, twists: Sequence[tuple[float, float]]) -> None:
        """Advance by `TICK_S` with (speed [m/s], turn rate [rad/s]) commanded to each robot.

        Raises:
            FloatingPointError: the physics diverged.
        """
        control = self._data.ctrl
        for i, (speed_mps, turn_radps) in enumerate(twists):
            left, right = self._robots[i].wheel_speeds(speed_mps, turn_radps)
            if self._drive is Drive.WHEELS:
                control[2 * i], control[2 * i + 1] = left, right
            else:
                self._command_planar(i, left, right)
        if self._nearby is not None:
            self._slots.fill(self._nearby.solids_at(self._poses_w))
        mujoco.mj_step(self._model, self._data, nstep=self._substeps)
        self._ticks += 1
        before_w = self._poses_w.copy()
        for i in range(len(self._robots)):
            self._read_pose(i)
        if self._drive is Drive.PLANAR:
            self._turn_planar_wheels(before_w)
        else:
            self._read_wheels()
        if any(self._data.warning[kind].number for kind in _DIVERGED) or not np.isfinite(self._poses_w).all():
            raise FloatingPointError(f"the physics diverged at {self.time_s:.2f} s")

    @property
    def time_s(self) -> float:
        """Simulated time."""
        return self._ticks * TICK_S

    def poses_w(self) -> Array:
        """(R, 3) true x, y [m] and yaw [rad] (unrolled) of each robot in w."""
        return self._poses_w.copy()

    def wheels_rad(self, robot: int) -> tuple[float, float]:
        """True left and right wheel angle since the start."""
        return float(self._wheels_rad[robot, 0]), float(self._wheels_rad[robot, 1])

    def _command_planar(self, i: int, left_radps: float, right_radps: float) -> None:
        wheels = self._robots[i].wheels
        speed_mps = 0.5 * wheels.radius_m * (left_radps + right_radps)
        turn_radps = wheels.radius_m * (right_radps - left_radps) / wheels.track_m
        # The slides' axes are those of the start pose.
        heading = self._poses_w[i, 2] - self._starts_w[i, 2] + 0.5 * turn_radps * TICK_S
        self._data.ctrl[3 * i : 3 * i + 3] = (
            speed_mps * math.cos(heading),
            speed_mps * math.sin(heading),
            turn_radps,
        )

    def _read_pose(self, i: int) -> None:
        q = self._data.qpos[self._qpos[i] : self._qpos[i] + 7]
        pose = self._poses_w[i]
        if self._drive is Drive.PLANAR:
            start = self._starts_w[i]
            c, s = math.cos(start[2]), math.sin(start[2])
            pose[:] = (start[0] + c * q[0] - s * q[1], start[1] + s * q[0] + c * q[1], start[2] + q[2])
            return
        w, x, y, z = q[3], q[4], q[5], q[6]
        yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        pose[:] = (q[0], q[1], pose[2] + math.remainder(yaw - pose[2], 2.0 * math.pi))

    def _read_wheels(self) -> None:
        for i in range(len(self._robots)):
            # The wheels' hinges follow the robot's free joint.
            a = self._qpos[i] + 7
            self._wheels_rad[i] = self._data.qpos[a : a + 2]

    def _turn_planar_wheels(self, before_w: Array) -> None:
        """Wheel angles that would have given the motion, with relative normal slip per wheel and tick."""
        slip = 1.0 + self._slip * self._rng.standard_normal((len(self._robots), 2))
        for i, spec in enumerate(self._robots):
            dx, dy, turn = self._poses_w[i] - before_w[i]
            heading = before_w[i, 2] + 0.5 * turn
            forward = math.cos(heading) * dx + math.sin(heading) * dy
            half_turn_m = 0.5 * spec.wheels.track_m * turn
            turned = np.array([forward - half_turn_m, forward + half_turn_m]) / spec.wheels.radius_m
            self._wheels_rad[i] += turned * slip[i]
