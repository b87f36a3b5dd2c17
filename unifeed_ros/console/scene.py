"""The 3-D scene of the page: the arm, what stands around it, motions, the reward, and the hand that pulls."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import trimesh
import viser

from unifeed_ros.console.arm import GHOSTS, DrawnArm, load_urdf
from unifeed_ros.console.drawing import Bytes, reward_colours, tube, tube_radii
from unifeed_ros.console.motions import DrawnMotion
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.scene import Scene
from unifeed_ros.core.types import Array
from unifeed_ros.core.zones import Zone

CAMERA, LOOK_AT, FIELD_OF_VIEW = (1.8, 1.1, 1.35), (0.5, 0.02, 0.02), 1.0
"""First view: across the way from start to goal [m], [m], [rad]."""
GRIP_RADIUS = 0.055
"""Radius of the ball at the hand [m]."""
TABLE_SIZE, TABLE_THICKNESS = (1.3, 1.5), 0.04
"""Edges and thickness of the drawn table [m]."""
SLICE_LOW, SLICE_HIGH = (0.1, -0.7), (0.9, 0.7)
"""Smallest and largest x and y of the slice of the reward [m]."""
WOOD, INK, GREEN, YELLOW, GREY = (214, 190, 160), (60, 64, 72), (0, 135, 90), (245, 190, 0), (120, 124, 130)
SMALLEST_MOVE = 5e-4
"""Smallest motion of a joint that is drawn [rad]."""
UPWARD = 1e-3
"""Space between surfaces that would flicker on each other [m]."""


class LessonScene:
    """Everything that is drawn around the lesson.

    Args:
        server: The page.
        robot: The arm.
        scene: The task.
        pullable: True if the mouse may pull the arm's hand.
        coarse: True: coarse meshes and no shadows, for machines without a graphics card.
    """

    def __init__(self, server: viser.ViserServer, robot: RobotModel, scene: Scene, *, pullable: bool,
                 coarse: bool) -> None:
        self._server, self._robot, self._task = server, robot, scene
        camera = server.initial_camera
        camera.position, camera.look_at, camera.fov = np.array(CAMERA), np.array(LOOK_AT), FIELD_OF_VIEW
        server.scene.configure_default_lights(cast_shadow=not coarse)
        self._surroundings(scene)
        self._arm = DrawnArm(server, robot, load_urdf(robot, meshes="collision" if coarse else "visual"), "/arm",
                             (225, 228, 232, 1.0) if coarse else None)
        self._ghosts = {name: DrawnArm(server, robot, load_urdf(robot, meshes="collision"), f"/ghost_{name}", colour)
                        for name, colour in GHOSTS.items()}
        for ghost in self._ghosts.values():
            ghost.visible = False
        self._grip = server.scene.add_icosphere("/grip", GRIP_RADIUS, YELLOW, opacity=0.85, visible=pullable)
        self._cup = self._add_cup() if scene.task == "cup" else None
        self._drawn: dict[str, viser.SceneNodeHandle] = {}
        self._tool = np.zeros(3)
        self._shown = np.full(robot.n, np.inf)

    def on_pull(self, pull: Callable[[str, int, Array | None], None]) -> None:
        """Tell what the mouse does to the ball at the hand.

        Args:
            pull: Gets "start", "update" or "end", the page, and where the tool is wanted, shape (3,) [m].
        """
        offset = np.zeros(3)

        # a coroutine, so that the phases of one drag come in their order
        @self._grip.on_drag
        async def _(event: viser.SceneNodeDragEvent) -> None:
            nonlocal offset
            if event.phase == "start":
                offset = np.asarray(event.start_position) - self._tool
            pull(event.phase, event.client_id,
                 None if event.phase == "end" else np.asarray(event.end_position) - offset)

    def move_arm(self, positions: Array) -> None:
        """Show the arm's posture, shape (n,) [rad]; one that nobody could tell from the last is not sent."""
        if np.abs(positions - self._shown).max() < SMALLEST_MOVE:
            return
        self._shown = positions
        position, rotation = self._robot.tool_pose(positions)
        with self._server.atomic():
            self._arm.move(positions)
            self._tool = position
            self._grip.position = position
            if self._cup is not None:
                self._cup.position = position - rotation[:, 2] * 0.02
                self._cup.wxyz = viser.transforms.SO3.from_matrix(rotation).wxyz

    def show_plan(self, motion: DrawnMotion | None, rewards: Array, disagreement: Array) -> None:
        """Draw the planned motion: colour is the learned reward, width the networks' disagreement."""
        self._tube("/plan", motion, rewards, disagreement)

    def show_line(self, name: str, motion: DrawnMotion | None, colour: tuple[int, int, int]) -> None:
        """Draw a motion as a thin line, or take it away."""
        self._remove(name)
        if motion is not None:
            segments = np.stack([motion.path[:-1:2], motion.path[1::2]], axis=1)  # every other one: a broken line
            self._drawn[name] = self._server.scene.add_line_segments(
                name, segments, colour, thickness=3.0, thickness_units="screen")

    def show_options(self, options: dict[str, DrawnMotion]) -> None:
        """Draw the motions of a question as coloured paths with ghosts; an empty one ends it."""
        for name in GHOSTS:
            motion = options.get(name)
            self._remove(f"/option_{name}")
            self._remove(f"/option_label_{name}")
            self._ghosts[name].visible = motion is not None
            if motion is not None:
                colour = np.asarray(GHOSTS[name][:3], dtype=np.uint8)
                vertices, faces = tube(motion.path, np.full(len(motion.path), 0.008))
                self._drawn[f"/option_{name}"] = self._server.scene.add_mesh_simple(
                    f"/option_{name}", vertices, faces, color=tuple(int(c) for c in colour), cast_shadow=False)
                middle = motion.path[len(motion.path) // 2]
                self._drawn[f"/option_label_{name}"] = self._server.scene.add_label(
                    f"/option_label_{name}", f"motion {name}", position=_above(middle, 0.05))
                self._ghosts[name].move(motion.positions[0])

    def move_ghost(self, name: str, positions: Array | None) -> None:
        """Show a ghost in a posture, shape (n,) [rad]; None hides it."""
        self._ghosts[name].visible = positions is not None
        if positions is not None:
            self._ghosts[name].move(positions)

    def show_slice(self, picture: Bytes | None, height: float) -> None:
        """Lay a picture of the reward into the workspace, rows along y from the smallest on; None takes it away."""
        self._remove("/slice")
        if picture is not None:
            middle = 0.5 * (np.add(SLICE_LOW, SLICE_HIGH))
            width, depth = np.subtract(SLICE_HIGH, SLICE_LOW)
            # seen from above, the picture's top row lies at the largest y
            rgba = np.dstack([picture[::-1], np.full(picture.shape[:2], 190, dtype=np.uint8)])
            self._drawn["/slice"] = self._server.scene.add_image(
                "/slice", rgba, float(width), float(depth), position=(*middle, height + UPWARD),
                wxyz=(0.0, 1.0, 0.0, 0.0), cast_shadow=False, receive_shadow=False)

    def _tube(self, name: str, motion: DrawnMotion | None, rewards: Array, disagreement: Array) -> None:
        self._remove(name)
        if motion is None:
            return
        vertices, faces = tube(motion.path, tube_radii(disagreement))
        colours = np.repeat(reward_colours(rewards), len(vertices) // len(motion.path), axis=0)
        mesh = trimesh.Trimesh(vertices, faces, vertex_colors=colours, process=False)
        self._drawn[name] = self._server.scene.add_mesh_trimesh(name, mesh, cast_shadow=False, receive_shadow=False)

    def _remove(self, name: str) -> None:
        if name in self._drawn:
            self._drawn.pop(name).remove()

    def _surroundings(self, scene: Scene) -> None:
        add = self._server.scene
        top = scene.table_height
        add.add_box("/table", WOOD, (*TABLE_SIZE, TABLE_THICKNESS), cast_shadow=False,
                    position=(0.35, 0.0, top - 0.5 * TABLE_THICKNESS - UPWARD))
        add.add_grid("/grid", *TABLE_SIZE, position=(0.35, 0.0, top), cell_size=0.1, section_size=0.5,
                     cell_color=(190, 168, 140), section_color=(160, 138, 110))
        for name, spot, colour in (("start", scene.start, GREY), ("goal", scene.goal, GREEN)):
            add.add_icosphere(f"/{name}", 0.03, colour, position=spot, opacity=0.6, cast_shadow=False)
            foot = np.array([[spot, [spot[0], spot[1], top]]])
            add.add_line_segments(f"/{name}_foot", foot, colour, thickness=2.0, thickness_units="screen")
            add.add_label(f"/{name}_label", name, position=_above(spot, 0.06))
        for name, position in scene.objects.items():
            draw = {"laptop": self._add_laptop, "person": self._add_person}.get(name, self._add_thing)
            draw(f"/object_{len(name)}_{name.replace('/', '_')}", position)
            add.add_label(f"/label_{name.replace('/', '_')}", name, position=_above(position, 0.3))
        for k, zone in enumerate(scene.zones.values()):
            self._add_zone(f"/zone_{k}", zone)

    def _add_laptop(self, name: str, position: Array) -> None:
        add = self._server.scene
        add.add_box(name, INK, (0.24, 0.34, 0.02), position=_above(position, 0.01))
        add.add_box(f"{name}/screen", (150, 180, 200), (0.01, 0.34, 0.22), position=(0.12, 0.0, 0.11))

    def _add_person(self, name: str, position: Array) -> None:
        add = self._server.scene
        add.add_cylinder(name, 0.4, UPWARD, (200, 110, 30), position=_above(position, UPWARD), opacity=0.35,
                         cast_shadow=False)
        add.add_cylinder(f"{name}_body", 0.13, 0.5, (96, 112, 150), position=_above(position, 0.25))
        add.add_icosphere(f"{name}_head", 0.1, (222, 184, 150), position=_above(position, 0.62))

    def _add_thing(self, name: str, position: Array) -> None:
        self._server.scene.add_box(name, INK, (0.06, 0.06, 0.06), position=_above(position, 0.03))

    def _add_cup(self) -> viser.SceneNodeHandle:
        cup = self._server.scene.add_frame("/cup", show_axes=False)
        self._server.scene.add_cylinder("/cup/side", 0.035, 0.09, (245, 245, 250))
        return cup

    def _add_zone(self, name: str, zone: Zone) -> None:
        colour, look = (200, 60, 60) if zone.speed == 0 else (200, 150, 60), {"opacity": 0.25, "cast_shadow": False}
        add = self._server.scene
        if zone.shape == "box":
            add.add_box(name, colour, tuple(zone.size), position=zone.position, **look)
        elif zone.shape == "sphere":
            add.add_icosphere(name, float(zone.size[0]), colour, position=zone.position, **look)
        else:
            shape = trimesh.creation.capsule(height=2 * zone.half_segment, radius=float(zone.size[0]))
            shape.apply_translation([0.0, 0.0, -shape.bounds.mean(axis=0)[2]])
            add.add_mesh_simple(name, shape.vertices, shape.faces, color=colour, position=zone.position, **look)


def _above(position: Array, height: float) -> Array:
    return position + np.array([0.0, 0.0, height])
