"""Where practices are found by name, in the order in which tables list them."""

from __future__ import annotations

from impact_xval.compliant_baselines.engines.mujoco_engine import MujocoSolver
from impact_xval.compliant_baselines.engines.pybullet_engine import PybulletSolver
from impact_xval.compliant_baselines.practical.bullet import BulletDocumented, BulletRestitution
from impact_xval.compliant_baselines.practical.calibrated import Calibrated
from impact_xval.compliant_baselines.practical.chipmunk import Chipmunk
from impact_xval.compliant_baselines.practical.dart import Dart
from impact_xval.compliant_baselines.practical.mjx import MjxDefault
from impact_xval.compliant_baselines.practical.mujoco_user import (
    MujocoDefault,
    MujocoDirect,
    MujocoDocumented,
)
from impact_xval.compliant_baselines.practical.newton import (
    NewtonFeatherstone,
    NewtonSemiImplicit,
    NewtonXpbd,
)
from impact_xval.compliant_baselines.practical.physx import NO_THRESHOLD, SHIPPED_THRESHOLD, Physx
from impact_xval.compliant_baselines.practical.practice import Practice
from impact_xval.compliant_baselines.practical.rapier import Rapier

#: Shares of the shortest contact period at which the calibrated adapters step.
SHARES = (1e-3, 1e-2, 0.03, 0.1)

_ALL = (
    *(Calibrated(MujocoSolver(), "MuJoCo", share) for share in SHARES),
    MujocoDefault(),
    MujocoDocumented(),
    MujocoDirect(),
    MjxDefault(),
    *(Calibrated(PybulletSolver(), "Bullet", share) for share in SHARES),
    BulletRestitution(),
    BulletDocumented(),
    Dart(),
    Chipmunk(),
    Chipmunk("pymunk-one-iteration", 1),
    Physx("sapien-shipped", True, SHIPPED_THRESHOLD),
    Physx("sapien-tgs", True, NO_THRESHOLD),
    Physx("sapien-pgs", False, NO_THRESHOLD),
    Rapier(),
    NewtonSemiImplicit(),
    NewtonFeatherstone(),
    NewtonXpbd(),
)

_PRACTICES: dict[str, Practice] = {practice.name: practice for practice in _ALL}


def practice_names() -> tuple[str, ...]:
    """Names of all practices, their engines installed or not."""
    return tuple(_PRACTICES)


def get_practice(name: str) -> Practice:
    """Give a practice by its name.

    Raises
    ------
    ValueError
        If none has that name; the message lists those that exist.
    """
    if name not in _PRACTICES:
        raise ValueError(f"practice {name!r} is unknown; known: {', '.join(_PRACTICES)}")
    return _PRACTICES[name]
