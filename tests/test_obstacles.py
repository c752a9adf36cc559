"""Rigid obstacles: closest points against sampling, derivatives against central differences, motion and errors."""

import numpy as np
import pytest

from dolfinx_mortar_al.obstacles import Obstacle, Pose, RigidCylinder, RigidPlane, RigidSphere
from dolfinx_mortar_al.surface import surface_normal
from dolfinx_mortar_al.variation import Slots, vary

pytestmark = pytest.mark.one_rank

OBSTACLES = {
    "line": lambda: RigidPlane(point=[0.2, -0.1], normal=[0.3, 2.0]),
    "plane": lambda: RigidPlane(point=[0.2, -0.1, 0.4], normal=[0.3, -1.0, 2.0]),
    "circle": lambda: RigidSphere(centre=[0.2, -0.1], radius=0.8),
    "circular hollow": lambda: RigidSphere(centre=[0.2, -0.1], radius=0.8, inside=True),
    "sphere": lambda: RigidSphere(centre=[0.2, -0.1, 0.4], radius=0.8),
    "spherical hollow": lambda: RigidSphere(centre=[0.2, -0.1, 0.4], radius=0.8, inside=True),
    "cylinder": lambda: RigidCylinder(point=[0.2, -0.1, 0.4], axis=[1.0, 2.0, -0.5], radius=0.8),
    "bore": lambda: RigidCylinder(point=[0.2, -0.1, 0.4], axis=[1.0, 2.0, -0.5], radius=0.8, inside=True),
}
ROUND = [name for name in OBSTACLES if name not in ("line", "plane")]
POSES = ["initial", "moved", "rotated"]


def obstacle_at(name: str, pose: str) -> Obstacle:
    obstacle = OBSTACLES[name]()
    translation = np.array([0.5, -0.3, 0.7])[: obstacle.gdim]
    if pose == "moved":
        obstacle.move(translation)
    if pose == "rotated":
        obstacle.move(translation, 0.7 if obstacle.gdim == 2 else [0.4, -0.9, 1.3])
    return obstacle


def points_around(obstacle: Obstacle, n: int = 40) -> np.ndarray:
    """(n, gdim) on both sides of the surface, none close to a centre or axis."""
    rng = np.random.default_rng(7)
    centre = obstacle.positions(obstacle.pivot[None])
    x = centre + rng.uniform(-1.5, 1.5, (20 * n, obstacle.gdim))
    if not isinstance(obstacle, RigidPlane):
        at = obstacle.project(x)
        depth = at.g if not obstacle.inside else -at.g  # inwards from the surface
        x = x[depth < 0.75 * obstacle.radius]
    return x[:n]


def material_point(obstacle: Obstacle, u: np.ndarray) -> np.ndarray:
    """(m, gdim) initial positions of points of the surface at parameters u (m, gdim − 1)."""
    if isinstance(obstacle, RigidSphere):
        c = [np.cos(u[:, 0]), np.sin(u[:, 0])]
        if obstacle.gdim == 3:
            c = [c[0] * np.cos(u[:, 1]), c[1] * np.cos(u[:, 1]), np.sin(u[:, 1])]
        return obstacle.pivot + obstacle.radius * np.stack(c, axis=1)
    normal = obstacle.axis if isinstance(obstacle, RigidCylinder) else obstacle.normal
    across = np.linalg.svd(normal[None])[2][1:]  # (dim, gdim), orthonormal
    if isinstance(obstacle, RigidPlane):
        return obstacle.pivot + u @ across
    circle = np.stack([np.cos(u[:, 0]), np.sin(u[:, 0])], axis=1) @ across
    return obstacle.pivot + obstacle.radius * circle + u[:, 1:] * obstacle.axis


def sampled_distance(obstacle: Obstacle, x: np.ndarray) -> float:
    """Distance of one point by samples of the surface, ever denser around the closest one."""
    dim = obstacle.gdim - 1
    grid = np.stack(np.meshgrid(*[np.linspace(-1, 1, 41)] * dim), axis=-1).reshape(-1, dim)
    middle, width = np.zeros(dim), 4.0
    for _ in range(12):
        u = middle + width * grid
        distance = np.linalg.norm(x - obstacle.positions(material_point(obstacle, u)), axis=1)
        middle, width = u[np.argmin(distance)], width / 5
    return float(distance.min())


@pytest.mark.parametrize("pose", POSES)
@pytest.mark.parametrize("name", OBSTACLES)
def test_distance_is_that_of_samples(name, pose):
    obstacle = obstacle_at(name, pose)
    x = points_around(obstacle, 8)
    at = obstacle.project(x)
    assert np.allclose(np.abs(at.g), [sampled_distance(obstacle, p) for p in x], atol=1e-12)
    assert np.allclose(x, at.y - at.g[:, None] * at.ν, atol=1e-14)


@pytest.mark.parametrize("pose", POSES)
@pytest.mark.parametrize("name", OBSTACLES)
def test_derivatives_are_those_of_central_differences(name, pose):
    obstacle = obstacle_at(name, pose)
    x = points_around(obstacle)
    d, h = obstacle.gdim, 1e-5
    at = obstacle.project(x)
    assert (at.g > 0.05).any() and (at.g < -0.05).any()
    δ = vary(at, Slots(d, 1, ("x", "w", *(f"w,{α}" for α in range(d - 1)), "w_p")))
    exact = {"y": δ.s[:, :, :d], "g": δ.g[:, :d], "ν": δ.ν[:, :, :d]}
    for key, derivative in exact.items():
        ends = [[getattr(obstacle.project(x + sign * e), key) for e in h * np.eye(d)] for sign in (1, -1)]
        difference = np.stack([(p - m) / (2 * h) for p, m in zip(*ends, strict=True)], axis=-1)
        scale = max(np.abs(derivative).max(), 1e-3)  # ν of a plane does not vary
        assert np.abs(difference - derivative).max() < 1e-6 * scale, key
    assert np.allclose(at.a @ exact["y"], δ.η[:, :, :d], atol=1e-14)


@pytest.mark.parametrize("pose", POSES)
@pytest.mark.parametrize("name", OBSTACLES)
def test_the_map_has_the_shapes_and_the_frame_of_a_projection(name, pose):
    obstacle = obstacle_at(name, pose)
    d, n = obstacle.gdim, 40
    for x in (points_around(obstacle, n), np.zeros((0, d))):  # a rank without facets has no points
        n = len(x)
        at = obstacle.project(x)
        assert at.N.shape == (n, 0) and at.dN.shape == (n, d - 1, 0) and at.point.η.shape == (n, d)
        assert at.point.facet.dtype == np.int64 and not at.point.facet.any()
        assert at.facing.all() and at.inside.all() and at.facing.shape == at.inside.shape == (n,)
        assert np.allclose(at.a @ np.swapaxes(at.a, 1, 2), np.eye(d - 1), atol=1e-14)
        assert np.allclose(surface_normal(at.a), at.ν, atol=1e-14)
        assert np.allclose(at.A_inv, np.eye(d - 1))
        assert np.allclose(at.Ā_inv @ (np.eye(d - 1) + at.g[:, None, None] * at.κ), np.eye(d - 1), atol=1e-13)
        assert at.take(np.arange(n)[::2]).N.shape == ((n + 1) // 2, 0)


@pytest.mark.parametrize("pose", POSES)
@pytest.mark.parametrize("name", OBSTACLES)
def test_material_point_is_carried_by_the_motion(name, pose):
    obstacle = obstacle_at(name, pose)
    x = points_around(obstacle)
    at = obstacle.project(x)
    assert np.allclose(obstacle.positions(at.point.η), at.y, rtol=0, atol=1e-14)
    # Y lies on the initial surface, and is its own closest point
    initial = OBSTACLES[name]().project(at.point.η)
    assert np.allclose(initial.g, 0, atol=1e-14)
    assert np.allclose(initial.point.η, at.point.η, atol=1e-14)


@pytest.mark.parametrize("turned", [0.0, 1e-7, 1.0, 3.0])
@pytest.mark.parametrize("name", OBSTACLES)
def test_sweep_is_the_velocity_at_the_end_of_a_uniform_motion(name, turned):
    """Against central differences about the end of a motion from the initial pose at a constant rate; rad."""
    obstacle = OBSTACLES[name]()
    way = np.array([0.5, -0.3, 0.7])[: obstacle.gdim]
    axis = np.array([1.0, -2.0, 2.0]) / 3
    Y, h = points_around(obstacle), 1e-6

    def at(t):
        obstacle.move(t * way, t * turned if obstacle.gdim == 2 else t * turned * axis)
        return obstacle.positions(Y)

    difference = (at(1 + h) - at(1 - h)) / (2 * h)
    y = at(1.0)
    assert np.allclose(obstacle.sweep(y, Pose.initial(obstacle.gdim)), difference, rtol=0, atol=1e-8)


def test_gap_is_positive_in_penetration():
    down, up = np.array([[0.0, -0.1]]), np.array([[0.0, 0.1]])
    ground = RigidPlane([3.0, 0.0], [0.0, 5.0])
    assert np.allclose([ground.project(down).g, ground.project(up).g], [[0.1], [-0.1]])
    x = np.array([[0.0, 0.0, 1.5], [0.0, 0.0, 2.5]])
    for inside, sign in ((False, 1.0), (True, -1.0)):
        for obstacle in (RigidSphere([0, 0, 0], 2.0, inside), RigidCylinder([0, 9, 0], [0, 1, 0], 2.0, inside)):
            at = obstacle.project(x)
            assert np.allclose(at.g, [0.5 * sign, -0.5 * sign])
            assert np.allclose(at.ν, [0, 0, sign])
            assert np.allclose(at.y, [0, 0, 2])
            assert np.allclose(at.κ[:, 0, 0], -0.5 * sign)


def test_a_quarter_turn_and_a_shift():
    """A line with normal e₂ turned by +90° about (1, 0) and moved by e₁: the line x = 2 with normal −e₁."""
    line = RigidPlane([1.0, 0.0], [0.0, 1.0])
    line.move([1.0, 0.0], np.pi / 2)
    at = line.project(np.array([[2.5, 0.3]]))
    assert np.allclose(at.ν, [[-1, 0]]) and np.allclose(at.y, [[2, 0.3]]) and np.allclose(at.g, [0.5])
    assert np.allclose(at.point.η, [[1.3, 0.0]])  # 0.3 from the pivot along the line
    solid = RigidPlane([1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    solid.move([1.0, 0.0, 0.0], [0.0, 0.0, np.pi / 2])
    assert np.allclose(solid.project(np.array([[2.5, 0.3, 0.0]])).point.η, [[1.3, 0.0, 0.0]])


@pytest.mark.parametrize("name", ["circle", "circular hollow", "sphere", "spherical hollow"])
def test_a_sphere_in_rotation_about_its_centre_turns_its_material_only(name):
    obstacle = OBSTACLES[name]()
    x, angle = points_around(obstacle), 0.4
    before = obstacle.project(x)
    obstacle.move(np.zeros(obstacle.gdim), angle if obstacle.gdim == 2 else [0.0, 0.0, angle])
    after = obstacle.project(x)
    for key in ("y", "ν", "g"):
        assert np.allclose(getattr(after, key), getattr(before, key), rtol=0, atol=1e-14), key
    arm = [(at.point.η - obstacle.pivot)[:, :2] for at in (before, after)]
    turned = [np.arctan2(r[:, 1], r[:, 0]) for r in arm]
    assert np.allclose(np.exp(1j * (turned[1] - turned[0])), np.exp(-1j * angle))


@pytest.mark.parametrize("pose", POSES)
@pytest.mark.parametrize("name", ROUND)
def test_centre_and_axis_face_nothing(name, pose):
    obstacle = obstacle_at(name, pose)
    centre = obstacle.positions(obstacle.pivot[None])
    at = obstacle.project(np.concatenate([centre, points_around(obstacle, 2)]))
    assert at.facing.tolist() == [False, True, True]
    values = (at.point.η, at.y, at.a, at.ν, at.g, at.κ, at.Ā_inv)
    assert all(np.isfinite(v).all() for v in values)
    assert np.allclose(np.abs(at.g[0]), obstacle.radius)


@pytest.mark.parametrize("name", OBSTACLES)
def test_a_pose_is_a_copy_that_can_be_set(name):
    obstacle = obstacle_at(name, "rotated")
    x = points_around(obstacle)
    y, kept = obstacle.project(x).y, obstacle.pose
    translation = np.ones(obstacle.gdim)
    obstacle.move(translation)
    translation[:] = 9.0
    assert np.allclose(obstacle.pose.translation, 1.0) and np.allclose(obstacle.pose.rotation, np.eye(obstacle.gdim))
    obstacle.pose = kept
    kept.translation[:] = 9.0
    obstacle.pose.rotation[:] = 9.0
    assert np.array_equal(obstacle.project(x).y, y)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: RigidPlane([0, 0], [0, 0]), r"normal = \[0, 0\]: a zero vector"),
        (lambda: RigidPlane([0, 0], [0, 0, 1]), r"normal = \[0, 0, 1\]: needs 2 finite"),
        (lambda: RigidPlane([0], [1]), r"point = \[0\]: needs 2 or 3 finite"),
        (lambda: RigidPlane([0, np.nan], [0, 1]), "point = .*: needs 2 or 3 finite"),
        (lambda: RigidSphere(0.0, 1.0), "centre = 0.0: needs 2 or 3"),
        (lambda: RigidSphere([0, 0], 0.0), "radius = 0.0: needs a positive"),
        (lambda: RigidSphere([0, 0], -1.0), "radius = -1.0: needs a positive"),
        (lambda: RigidSphere([0, 0], np.inf), "radius = inf: needs a positive"),
        (lambda: RigidSphere([0, 0, 0], np.nan), "radius = nan: needs a positive"),
        (lambda: RigidCylinder([0, 0], [0, 1], 1.0), r"point = \[0, 0\]: needs 3 finite"),
        (lambda: RigidCylinder([0, 0, 0], [0, 1], 1.0), r"axis = \[0, 1\]: needs 3 finite"),
        (lambda: RigidCylinder([0, 0, 0], [0, 0, 0], 1.0), r"axis = \[0, 0, 0\]: a zero vector"),
        (lambda: RigidCylinder([0, 0, 0], [0, 0, 1], -2.0), "radius = -2.0: needs a positive"),
        (lambda: RigidSphere([0, 0], 1.0).move([0, 0, 1]), "translation = .*: needs 2 finite"),
        (lambda: RigidSphere([0, 0], 1.0).move([0, 0], [0, 0, 1]), "rotation = .*: needs one finite angle"),
        (lambda: RigidSphere([0, 0, 0], 1.0).move([0, 0, 0], 0.3), "rotation = 0.3: needs 3 finite"),
    ],
)
def test_errors_name_the_argument_and_its_value(make, message):
    with pytest.raises(ValueError, match=message):
        make()


@pytest.mark.parametrize("Q", [np.eye(3), 2 * np.eye(2), np.diag([1.0, -1.0])])
def test_a_pose_that_is_no_rotation_is_refused(Q):
    with pytest.raises(ValueError, match=r"rotation = .*: needs an orthogonal 2×2 matrix"):
        RigidSphere([0, 0], 1.0).pose = Pose(np.zeros(2), Q)


@pytest.mark.parametrize("name", OBSTACLES)
def test_what_goes_with_its_surface_keeps_its_distance(name):
    """From a pose to another, however far; turns of the surface in itself do not move it."""
    rng = np.random.default_rng(5)
    obstacle = OBSTACLES[name]()
    x = rng.normal(size=(20, obstacle.gdim))
    for rotation in rng.normal(size=(6, 2 * obstacle.gdim - 3)):
        before, g = obstacle.pose, obstacle.project(x).g
        obstacle.move(rng.normal(size=obstacle.gdim), 2.0 * rotation)
        there = obstacle.carried(x, before)
        assert np.allclose(obstacle.project(there).g, g, atol=1e-13)
        apart = [np.linalg.norm(v[1:] - v[0], axis=1) for v in (x, there)]
        assert np.allclose(*apart, atol=1e-13)


@pytest.mark.parametrize("name", ["sphere", "cylinder", "bore"])
def test_what_turns_in_itself_carries_nothing(name):
    obstacle, x = OBSTACLES[name](), np.random.default_rng(6).normal(size=(20, 3))
    before = obstacle.pose
    obstacle.move(np.zeros(3), 2.0 * getattr(obstacle, "axis", np.ones(3)))
    assert np.allclose(obstacle.carried(x, before), x, atol=1e-13)
