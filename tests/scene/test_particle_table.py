"""Particle tables in the formats of other programs, and messages about invalid rows."""

import numpy as np
import pytest
from observers.snapshots import particles_of, snapshot_of

from granflow.errors import SceneError
from granflow.observers.frames import ParticleFrames
from granflow.particles.file import MOST_SHOWN, read_particles

POSITION = np.array([[0.1, -0.2, 0.3], [0.0, 1.5e-3, -4.0]])
RADIUS = np.array([0.002, 0.0035])

FORMATS = {
    "commas": "id,x,y,z,r\n1,0.1,-0.2,0.3,0.002\n2,0,1.5e-3,-4,0.0035\n",
    "semicolons and decimal commas": "X; Y; Z; Diameter\n0,1;-0,2;0,3;0,004\n0;0,0015;-4;0,007\n",
    "tabs": "Radius\tPosition X\tPosition Y\tPosition Z\n0.002\t0.1\t-0.2\t0.3\n0.0035\t0\t0.0015\t-4\n",
    "spaces and units": "Radius[m] PosX[m] PosY[m] PosZ[m]\n 0.002 0.1 -0.2 0.3\n\n 0.0035   0 0.0015 -4\n",
    "two sizes that agree": "x,y,z,r [mm],d [m]\n0.1,-0.2,0.3,2,0.004\n0,0.0015,-4,3.5,0.00700001\n",
    "mixed blanks": "Radius[m]\tPosX[m] PosY[m] PosZ[m]\n 0.002 0.1 -0.2 0.3\n 0.0035 0 0.0015 -4\n",
    "millimeters": "d [mm], x (mm), y (mm), z (m), what\n4, 100, -200, 0.3, a\n7, 0, 1.5, -4, b\n",
    "comments": "# made by hand\n# x y z r\n0.1 -0.2 0.3 0.002\n# the other\n0 0.0015 -4 0.0035\n",
    "quotes and empty ends": '"x","y","z","radius",\n0.1,-0.2,0.3,0.002,\n0,0.0015,-4,0.0035,\n',
    "paraview": '"radius","Points:0","Points:1","Points:2"\n0.002,0.1,-0.2,0.3\n0.0035,0,0.0015,-4\n',
}


def written(tmp_path, text):
    path = tmp_path / "start.csv"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("text", FORMATS.values(), ids=FORMATS)
def test_all_formats_give_the_same_particles(tmp_path, text):
    table = read_particles(written(tmp_path, text))
    np.testing.assert_allclose(table.position, POSITION, rtol=1e-15)
    np.testing.assert_allclose(table.radius, RADIUS, rtol=1e-15)
    assert table.velocity is None and table.angular_velocity is None


def test_velocity_angular_velocity_and_material_are_read(tmp_path):
    heads = "x,y,z,r,vx[cm/s],vy[cm/s],vz[cm/s],spin_x,spin_y,spin_z,material"
    rows = "0,0,0,1,100,0,-50,1,2,3,glass\n3,0,0,1,0,0,0,0,0,0,steel"
    table = read_particles(written(tmp_path, f"{heads}\n{rows}\n"))
    np.testing.assert_allclose(table.velocity, [[1, 0, -0.5], [0, 0, 0]])
    np.testing.assert_allclose(table.angular_velocity[0], [1, 2, 3])
    assert table.material.tolist() == ["glass", "steel"] and table.line.tolist() == [2, 3]


@pytest.mark.parametrize(("text", "messages"), [
    ("x,y,z,r\n0,0,0,1\n0,0,1\n", ["3: the row has 3 values, but the header in line 1 has 4 columns."]),
    ("x,y,z,r\n0,0,abc,1\n0,,0,1\n", ["2: z is abc, but a number is", "3: y is empty, but a number is"]),
    ("x y z r\n0 nan 0 1\n0 0 0 inf\n", ["2: the position is not finite.", "3: the radius is not finite."]),
    ("x y z r\n0 0 0 0\n0 0 0 -1\n", ["2: the radius must be above 0.", "3: the radius must be above 0."]),
    ("0,0,0,1\n", ["1: the first line must be a header with the columns x, y, z and r"]),
    ("x[furlong],y,z,r\n0,0,0,1\n", ["1: the unit of x[furlong] is invalid: furlong is not a known unit"]),
    ("x,y,z,r,r\n0,0,0,1,1\n", ["1: the header has r twice; keep one of the columns."]),
    ("x,y,z,r [m],R [mm]\n0,0,0,1,1\n", ["1: the header has both r [m] and R [mm]; keep one of the columns."]),
    ("x,y,z,r,diameter\n0,0,0,1,2\n0,0,0,1,1\n", ["3: r is 1, but diameter is 1: the columns contradict each"]),
    ("x,y,z,r,mat,material\n0,0,0,1,a,b\n", ["2: mat is a, but material is b: the columns contradict each other;"]),
    ("x,y,z,r,vx,vz\n0,0,0,1,1,1\n", ["1: the header has vx and vz, but not all three components of the velocity"]),
    ("x,y,z,r\n", [" the file contains no particles."]),
    ("x y z r\n" + "0 0 0\n" * (MOST_SHOWN + 5), [
        *(f"{n}: the row has 3 values" for n in range(2, MOST_SHOWN + 2)), " 5 more rows have problems",
    ]),
])  # fmt: skip
def test_invalid_rows_are_reported_with_their_line(tmp_path, text, messages):
    path = written(tmp_path, text)
    with pytest.raises(SceneError) as caught:
        read_particles(path)
    for found, message in zip(caught.value.problems, messages, strict=True):
        assert found.startswith(f"{path}:{message}")


def test_unreadable_files_are_rejected(tmp_path):
    for path, message in (
        (tmp_path / "no.csv", "there is no such file."),
        (tmp_path, "the file cannot be read: Is a directory"),
    ):
        with pytest.raises(SceneError, match=message):
            read_particles(path)


def test_vtu_frame_of_granflow_is_read_back(tmp_path):
    """In the precision of the file, float32."""
    snapshot = snapshot_of(particles=particles_of(50))
    ParticleFrames(tmp_path, 0.1).observe(snapshot)
    table = read_particles(tmp_path / "particles_0000.vtu")
    for name in ("position", "radius", "velocity", "angular_velocity"):
        np.testing.assert_array_equal(getattr(table, name), snapshot.particles[name].astype(np.float32))
    assert table.material.tolist() == [str(number) for number in snapshot.particles["material"]]
