import re

import numpy as np
import pytest
from drake_exo.models.make_meshes import exoskeleton_parts, human_parts
from drake_exo.models.sweeps import mirrored, obj_text, tube

from drake_exo.model.description import models_path

MESHES = models_path() / "meshes"


def parsed(text):
    """Vertices (n, 3) and triangles (m, 3), counted from 0."""
    lines = [line.split() for line in text.splitlines()]
    vertices = [line[1:] for line in lines if line[0] == "v"]
    faces = [
        [int(corner.split("/")[0]) - 1 for corner in line[1:]]
        for line in lines
        if line[0] == "f"
    ]
    return np.array(vertices, dtype=float), np.array(faces)


def volume(text):
    vertices, faces = parsed(text)
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    return np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0


@pytest.mark.slow
def test_round_tube_has_the_volume_of_a_capsule():
    keys = [(0.0, 0.0, 0.05, 0.05), (0.4, 0.0, 0.05, 0.05)]
    rings = tube(keys, around=96, roundness=1.0)
    capsule = np.pi * 0.05**2 * (0.4 + 4.0 / 3.0 * 0.05)
    assert volume(obj_text(rings)) == pytest.approx(capsule, rel=0.02)
    assert volume(obj_text(mirrored(rings))) == pytest.approx(capsule, rel=0.02)


def test_normals_of_a_tube_point_outwards():
    text = obj_text(tube([(0.0, 0.0, 0.05, 0.05), (0.4, 0.0, 0.05, 0.05)]))
    vertices, _ = parsed(text)
    normals = np.array(
        [v.split()[1:] for v in text.splitlines() if v.startswith("vn")],
        dtype=float,
    )
    outwards = vertices - np.array([0.0, 0.0, 0.2])
    assert (np.einsum("ij,ij->i", outwards, normals) > 0.0).all()


@pytest.mark.slow
def test_meshes_on_disk_are_those_drawn():
    parts = human_parts() | exoskeleton_parts()
    assert {path.stem for path in MESHES.glob("*.obj")} == set(parts)
    for name, rings in parts.items():
        vertices, faces = parsed((MESHES / f"{name}.obj").read_text())
        drawn, drawn_faces = parsed(obj_text(rings))
        np.testing.assert_allclose(vertices, drawn, atol=2e-5, err_msg=name)
        np.testing.assert_array_equal(faces, drawn_faces, err_msg=name)


def test_model_files_name_every_mesh_and_no_other():
    named = set()
    for model in ("human.sdf", "exoskeleton.sdf"):
        text = (models_path() / model).read_text()
        named |= set(re.findall(r"package://drake_exo/meshes/(\w+)\.obj", text))
    assert named == {path.stem for path in MESHES.glob("*.obj")}
