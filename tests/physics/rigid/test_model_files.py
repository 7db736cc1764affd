"""Models from strangers: good ones compile anywhere from memory, what reaches out of its folder is refused by name."""

import json
import os
import re
import resource
import struct
import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest

from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.executor.limited import ProcessLimits, call_limited
from neuroanimator.physics.rigid import compiled_model
from neuroanimator.physics.rigid.compiled_model import MEMORY_LIMIT, compile_model
from neuroanimator.systems.model_files import ModelFiles, read_model_files
from neuroanimator.systems.model_xml import Documents

BODY = '<worldbody><body name="b"><joint name="j"/><geom size="1"/></body></worldbody>'
INERTIA = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
DEFAULTS = '<mujocoinclude><default><default class="stiff"/></default></mujocoinclude>'
FACES = ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))


def stl(size: float) -> bytes:
    """Return a tetrahedron with three edges of `size` metres along the axes."""
    corners = [(0, 0, 0), (size, 0, 0), (0, size, 0), (0, 0, size)]
    faces = [
        struct.pack("<12fH", 0, 0, 0, *(x for corner in face for x in corners[corner]), 0)
        for face in FACES
    ]
    return bytes(80) + struct.pack("<I", len(faces)) + b"".join(faces)


def write(folder: Path, files: dict[str, str | bytes]) -> Path:
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    return folder / next(iter(files))


def mujoco_xml(inside: str = "", body: str = BODY) -> str:
    return f"<mujoco>{inside}{body}</mujoco>"


def urdf(mesh: str, visual: str = "") -> str:
    limit = '<axis xyz="0 1 0"/><limit lower="-1" upper="1"/>'
    shape = f'<collision><geometry><mesh filename="{mesh}"/></geometry></collision>'
    return (
        f'<robot name="r"><link name="a">{INERTIA}</link><link name="b">{INERTIA}{visual}{shape}</link>'
        f'<joint name="j" type="revolute"><parent link="a"/><child link="b"/>{limit}</joint>'
        '<gazebo><plugin filename="libx.so"/></gazebo></robot>'
    )


def refusal(main: Path) -> str:
    with pytest.raises(BadFileError) as caught:
        compile_model(read_model_files(main))
    message = str(caught.value)
    assert caught.value.exit_code == 3
    assert "\n" not in message
    return message


def good_model(folder: Path) -> Path:
    arm = '<mujocoinclude><body name="arm"><joint/><geom type="mesh" mesh="tip"/></body></mujocoinclude>'
    assets = '<mujocoinclude><asset><mesh file="tip.STL" /><mesh name="two" file="other/tip.STL"/></asset></mujocoinclude>'
    inside = '<compiler meshdir="meshes"/><include file="parts/assets.xml"/>'
    return write(
        folder,
        {
            "robot.xml": mujoco_xml(
                inside, '<worldbody><include file="parts/arm.xml"/></worldbody>'
            ),
            "parts/assets.xml": assets,
            "parts/arm.xml": arm,
            "meshes/tip.STL": stl(2),
            "meshes/other/tip.STL": stl(1),
        },
    )


def test_a_model_survives_json_and_compiles_without_its_folder(tmp_path, monkeypatch):
    files = read_model_files(good_model(tmp_path / "model"))
    again = ModelFiles.from_json(json.loads(json.dumps(files.to_json())))
    assert (again, hash(again)) == (files, hash(files))
    elsewhere = tmp_path / "elsewhere"
    write(elsewhere, dict.fromkeys(("tip.STL", "meshes/tip.STL"), b"not a mesh"))
    (tmp_path / "model").rename(tmp_path / "gone")
    monkeypatch.chdir(elsewhere)
    model = compile_model(again)
    assert model.body("arm").mass[0] == pytest.approx(1000 * 2**3 / 6)


def test_the_files_are_sorted_and_no_others_are_taken(tmp_path):
    write(tmp_path, {"secret.txt": "secret"})
    names = [name for name, _ in read_model_files(good_model(tmp_path)).files]
    assert names == [
        "meshes/other/tip.STL",
        "meshes/tip.STL",
        "parts/arm.xml",
        "parts/assets.xml",
        "robot.xml",
    ]


def test_two_models_whose_meshes_share_a_name_do_not_share_the_mesh(tmp_path):
    mesh = '<asset><mesh file="a.stl"/></asset>'
    body = '<worldbody><body><joint/><geom type="mesh" mesh="a"/></body></worldbody>'
    masses = [
        compile_model(
            read_model_files(
                write(tmp_path / str(size), {"m.xml": mujoco_xml(mesh, body), "a.stl": stl(size)})
            )
        ).body_mass[1]
        for size in (1, 2)
    ]
    assert masses[1] == pytest.approx(8 * masses[0])


@pytest.mark.parametrize(
    "mesh", ["meshes/a.stl", "package://robot/meshes/a.stl", "package://robot/elsewhere/b.stl"]
)
def test_a_urdf_compiles(tmp_path, mesh):
    visual = '<visual><geometry><mesh filename="package://robot/missing.dae"/></geometry></visual>'
    main = write(tmp_path, {"r.urdf": urdf(mesh, visual), "meshes/a.stl": stl(1), "b.stl": stl(1)})
    model = compile_model(read_model_files(main))
    assert model.joint("j").range.tolist() == [-1, 1]


def test_a_urdf_in_a_ros_package_finds_that_packages_meshes_and_no_others(tmp_path):
    files = {
        "robot/urdf/r.urdf": urdf("package://robot/meshes/a.stl"),
        "robot/meshes/a.stl": stl(1),
    }
    main = write(tmp_path, files)
    assert "leaves" not in refusal(main)
    assert "no such file" in refusal(main)
    (tmp_path / "robot/package.xml").write_text("<package/>")
    again = ModelFiles.from_json(json.loads(json.dumps(read_model_files(main).to_json())))
    assert compile_model(again).nmesh == 1
    (tmp_path / "b.stl").write_bytes(stl(1))
    outside = write(tmp_path, {"robot/urdf/s.urdf": urdf("package://robot/../b.stl")})
    assert "leaves the model's folder" in refusal(outside)


@pytest.mark.parametrize("place", ["a.stl", "meshes/a.stl", "models/robot/meshes/a.stl"])
def test_a_path_in_a_package_may_begin_above_the_models_folder(tmp_path, place):
    files = {"r.urdf": urdf("package://robots/models/robot/meshes/a.stl"), place: stl(1)}
    assert compile_model(read_model_files(write(tmp_path, files))).nmesh == 1


def test_a_package_may_be_called_as_a_folder_beside_the_model(tmp_path):
    files = {"r.urdf": urdf("package://meshes/collision/a.stl"), "meshes/collision/a.stl": stl(1)}
    assert compile_model(read_model_files(write(tmp_path, files))).nmesh == 1


def test_windows_paths_are_paths(tmp_path):
    files = {"r.urdf": urdf("meshes\\a.stl"), "meshes/a.stl": stl(1)}
    assert compile_model(read_model_files(write(tmp_path, files))).nmesh == 1


def test_what_mujoco_cannot_read_is_refused_with_what_it_can(tmp_path):
    files = {"r.urdf": urdf("a.dae"), "a.dae": b"<COLLADA/>"}
    assert "MuJoCo reads STL, OBJ and MSH" in refusal(write(tmp_path, files))


def test_macros_are_refused_and_a_colour_that_is_none_is_not(tmp_path):
    robot = urdf("a.stl")
    macro = robot.replace("</robot>", '<xacro:leg prefix="l"/></robot>').replace(
        "<robot", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"'
    )
    main = write(tmp_path, {"r.urdf": macro, "a.stl": stl(1)})
    assert "r.urdf: xacro:leg: xacro's macros are not expanded" in refusal(main)
    color = '<material name="blue"><color rgba="0 0 1 1 1"/></material></robot>'
    main = write(tmp_path, {"r.urdf": robot.replace("</robot>", color)})
    assert compile_model(read_model_files(main)).nmesh == 1


def test_a_nan_state_is_not_reset_silently(tmp_path):
    model = compile_model(read_model_files(write(tmp_path, {"m.xml": mujoco_xml()})))
    assert model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_AUTORESET


def test_compiling_leaves_no_log_and_logs_again_afterwards(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    unset_mass = BODY.replace(
        "<geom", '<geom mass="nan"'
    )  # MuJoCo warns of it, and takes the density instead
    main = write(tmp_path, {"m.xml": mujoco_xml(body=unset_mass)})
    assert np.isfinite(compile_model(read_model_files(main)).body_mass).all()
    assert os.listdir(tmp_path) == ["m.xml"]
    assert mujoco.MjLogConfig.get().logto_file


OUTSIDE = [
    "../secret.xml",
    "a/../../secret.xml",
    "/etc/passwd",
    "C:/a.xml",
    "C:\\a.xml",
    "..\\a.xml",
    "http://a/b.xml",
]


@pytest.mark.parametrize("path", [*OUTSIDE, "file:///etc/passwd", "package://a/b.xml"])
def test_an_include_outside_the_folder_is_refused(tmp_path, path):
    write(tmp_path, {"secret.xml": mujoco_xml()})
    main = write(tmp_path / "model", {"robot.xml": mujoco_xml(f'<include file="{path}"/>')})
    message = refusal(main)
    assert message.startswith(f"robot.xml: include file={path!r}: leaves the model's folder")
    assert "Put the file beside the model" in message or "new --tree" in message


def test_files_above_the_model_are_read_where_its_user_says_so(tmp_path, monkeypatch):
    inside = '<compiler meshdir="../meshes"/><asset><mesh name="a" file="a.stl"/></asset>'
    body = '<worldbody><body><joint/><geom type="mesh" mesh="a"/></body></worldbody>'
    tree = tmp_path / "robots"
    write(tree, {"meshes/a.stl": stl(1), "parts/body.xml": mujoco_xml(body=body)})
    main = write(tree, {"arm/m.xml": mujoco_xml(inside, '<include file="../parts/body.xml"/>')})
    assert f"use 'new --tree {tree}'" in refusal(main)
    files = read_model_files(main, tree)
    assert [name for name, _ in files.files] == ["arm/m.xml", "meshes/a.stl", "parts/body.xml"]
    assert compile_model(ModelFiles.from_json(files.to_json())).nmesh == 1
    monkeypatch.setenv("HOME", str(tree / "arm"))
    assert "Put the file beside the model" in refusal(main)
    with pytest.raises(ArgumentError, match="does not lie in"):
        read_model_files(main, tree / "meshes")


def test_the_folder_of_a_package_without_its_file_is_told(tmp_path):
    main = write(
        tmp_path / "robot",
        {"urdf/r.urdf": urdf("package://robot/meshes/a.stl"), "meshes/a.stl": stl(1)},
    )
    message = refusal(main)
    assert "no such file" in message
    assert f"use 'new --tree {tmp_path / 'robot'}'" in message
    assert compile_model(read_model_files(main, tmp_path / "robot")).nmesh == 1


ASSETS = [
    '<asset><mesh file="{}"/></asset>',
    '<asset><texture type="2d" file="{}"/></asset>',
    '<asset><texture fileleft="{}"/></asset>',
    '<asset><hfield file="{}" size="1 1 1 1"/></asset>',
    '<asset><skin file="{}"/></asset>',
]


@pytest.mark.parametrize("path", OUTSIDE)
@pytest.mark.parametrize("asset", ASSETS)
def test_an_asset_outside_the_folder_is_refused(tmp_path, asset, path):
    write(tmp_path, {"secret.xml": b"secret"})
    assert "leaves the model's folder" in refusal(
        write(tmp_path / "m", {"m.xml": mujoco_xml(asset.format(path))})
    )


@pytest.mark.parametrize("folder", ["..", "/etc", "a/../.."])
@pytest.mark.parametrize("setting", ["meshdir", "assetdir"])
def test_an_asset_folder_outside_is_refused(tmp_path, folder, setting):
    inside = f'<compiler {setting}="{folder}"/><asset><mesh file="a.stl"/></asset>'
    write(tmp_path, {"a.stl": stl(1)})
    assert repr(folder) in refusal(write(tmp_path / "m", {"m.xml": mujoco_xml(inside)}))


@pytest.mark.parametrize(
    "path", ["../a.stl", "package://r/../../a.stl", "package://r//etc/passwd", "http://h/a.stl"]
)
def test_a_urdf_mesh_outside_the_folder_is_refused(tmp_path, path):
    write(tmp_path, {"a.stl": stl(1)})
    message = refusal(write(tmp_path / "m", {"r.urdf": urdf(path)}))
    assert f"r.urdf: mesh filename={path!r}: leaves the model's folder" in message


@pytest.mark.parametrize("link", ["file", "folder", "main"])
def test_a_link_out_of_the_folder_is_refused(tmp_path, link):
    outside = write(tmp_path / "outside", {"a.xml": mujoco_xml()}).parent
    main = write(
        tmp_path / "m",
        {"m.xml": mujoco_xml(f'<include file="{"sub/" if link == "folder" else ""}a.xml"/>')},
    )
    if link == "main":
        main.unlink()
    {"file": main.parent / "a.xml", "folder": main.parent / "sub", "main": main}[link].symlink_to(
        outside if link == "folder" else outside / "a.xml"
    )
    assert "a link that leaves the model's folder" in refusal(main)


def test_missing_files_are_named(tmp_path):
    assert "m.xml: no such file" in refusal(tmp_path / "m.xml")
    main = write(tmp_path, {"m.xml": mujoco_xml('<asset><mesh name="x" file="a.stl"/></asset>')})
    assert "mesh 'x' file='a.stl': no such file" in refusal(main)


def test_circles_and_repeats_of_includes_are_refused(tmp_path):
    me = '<mujoco><include file="{}"/></mujoco>'
    circle = write(tmp_path, {"a.xml": me.format("b.xml"), "b.xml": me.format("a.xml")})
    assert "already included" in refusal(circle)
    parts = {"c.xml": mujoco_xml('<include file="d.xml"/>' * 2), "d.xml": mujoco_xml()}
    twice = write(tmp_path, parts)
    assert "already included" in refusal(twice)


def attaching(name: str, child: str, meshdir: str, included: str) -> str:
    """Return a body with a mesh of its own that attaches the model in the file `child`, if there is one."""
    asset = '<mesh name="m" file="m.stl"/>'
    attach = ""
    if child:
        asset += f'<model name="child" file="{child}"/>'
        attach = '<frame pos="0 0 -1"><attach model="child" body="body" prefix="of_"/></frame>'
    motor = f'<actuator><motor name="{name}" joint="j" ctrlrange="-1 1"/></actuator>'
    body = (
        '<worldbody><body name="body"><joint name="j" class="stiff" axis="0 1 0"/>'
        f'<geom type="mesh" mesh="m"/>{attach}</body></worldbody>'
    )
    return (
        f'<mujoco model="{name}"><compiler meshdir="{meshdir}"/><include file="{included}"/>'
        f"<asset>{asset}</asset>{body}{motor}</mujoco>"
    )


def test_models_inside_models_are_read_as_mujoco_reads_them_wherever_their_files_lie(tmp_path):
    rng = np.random.default_rng(0)
    places = ["", "arm/", "arm/hand/", "parts/"]
    for number in range(12):
        folder = tmp_path / str(number)
        depth = int(rng.integers(2, 4))
        of_model = ["", *rng.choice(places, depth - 1).tolist()]
        files: dict[str, str | bytes] = {}
        for level, place in enumerate(of_model):
            child = ""
            if level + 1 < depth:
                there = f"{of_model[level + 1]}{level + 1}.xml"
                child = os.path.relpath(there, place or ".")
            meshdir = str(rng.choice(["", "meshes", "meshes/fine"]))
            included = f"defaults{level}.xml"
            files[f"{place}{level}.xml"] = attaching(f"m{level}", child, meshdir, included)
            stiffness = f'<joint stiffness="{level + 1}"/>'
            defaults = f'<default><default class="stiff">{stiffness}</default></default>'
            files[f"{place}{included}"] = f"<mujocoinclude>{defaults}</mujocoinclude>"
            mesh = os.path.normpath(f"{place}{meshdir}/m.stl") if place or meshdir else "m.stl"
            files[mesh] = stl(1 + level)
        main = write(folder, files)
        read = read_model_files(main)
        assert {name for name, _ in read.files} == set(files)
        request = compiled_model.ModelRequest(read.main, read.documents())
        content = compiled_model.compile_here(request)
        ours = mujoco.MjModel.from_binary_path("m.mjb", {"m.mjb": content})
        own = mujoco.MjModel.from_xml_path(str(main))
        assert (ours.nmesh, ours.nu, ours.names) == (own.nmesh, own.nu, own.names)
        np.testing.assert_array_equal(ours.body_mass, own.body_mass)
        np.testing.assert_array_equal(ours.jnt_stiffness, own.jnt_stiffness)


def test_a_model_that_attaches_itself_is_refused(tmp_path):
    files = {f"{me}.xml": attaching(me, f"{other}.xml", "", "d.xml") for me, other in ("ab", "ba")}
    main = write(tmp_path, files | {"m.stl": stl(1), "d.xml": "<mujocoinclude/>"})
    assert "a.xml attaches b.xml attaches a.xml: no model may attach itself" in refusal(main)


def test_a_model_attached_from_another_folder_is_read_as_the_message_says(tmp_path, monkeypatch):
    hand = {"hand/hand.xml": attaching("hand", "", "assets", "d.xml"), "hand/assets/m.stl": stl(1)}
    arm = {"arm/arm.xml": attaching("arm", "../hand/hand.xml", "assets", "d.xml")}
    shared = {"hand/d.xml": DEFAULTS, "arm/d.xml": DEFAULTS, "arm/assets/m.stl": stl(2)}
    main = write(tmp_path, arm | hand | shared)
    told = re.search(r"use 'new --tree (\S+)'", refusal(main))
    assert told is not None
    assert compile_model(read_model_files(main, Path(told[1]))).nmesh == 2


@pytest.mark.parametrize(
    "declaration",
    [
        "<!DOCTYPE mujoco>",
        '<!DOCTYPE m [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;">]>',
        '<!DOCTYPE m [<!ENTITY a SYSTEM "file:///etc/passwd">]>',
        '<!DOCTYPE m SYSTEM "http://localhost/a.dtd">',
    ],
)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_document_types_and_entities_are_refused(tmp_path, declaration, encoding):
    main = write(tmp_path, {"m.xml": (declaration + mujoco_xml()).encode(encoding)})
    assert "m.xml: DOCTYPE 'm" in refusal(main)


@pytest.mark.parametrize(
    "content", [b"", b"\0\1\2", b"<mujoco>", b"{}", b'<?xml version="1.0" encoding="no"?><a/>']
)
def test_what_is_not_xml_is_refused(tmp_path, content):
    assert "m.xml: not XML" in refusal(write(tmp_path, {"m.xml": content}))


def test_too_much_is_refused(tmp_path):
    mesh = '<mesh file="{}.stl"/>'.format
    many = {f"{index}.stl": b"x" for index in range(2001)}
    asset = f"<asset>{''.join(map(mesh, range(2001)))}</asset>"
    assert "more than 2,000 files" in refusal(write(tmp_path, {"m.xml": mujoco_xml(asset), **many}))
    sites = "<worldbody>" + "<site/>" * 10_001 + "</worldbody>"
    assert "more than 10,000 elements" in refusal(write(tmp_path, {"m.xml": mujoco_xml(sites)}))
    deep = "<a>" * 9_000 + "</a>" * 9_000
    assert "100 elements deep" in refusal(write(tmp_path, {"m.xml": deep}))


SKY = '<asset><texture type="2d" name="sky" builtin="flat" width="99999" height="99999"/></asset>'
PNG = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR" + struct.pack(">II", 60000, 60000)
PICTURE = '<asset><texture type="2d" file="bomb.png"/></asset>'
REFUSALS = {
    "bodies (nbody=602): at most 500": '<worldbody><replicate count="600"><body name="many"/></replicate></worldbody>',
    "bad format in attribute 'count'": '<worldbody><replicate count="x"/></worldbody>',
    "composite: composites are not supported": '<worldbody><body><composite type="cable" count="999 1 1"/></body></worldbody>',
    "flexcomp 'f' count='99 99 99': 970,299 nodes": '<worldbody><flexcomp name="f" count="99 99 99"/></worldbody>',
    "plugin: plugins run": '<extension><plugin plugin="mujoco.elasticity.cable"/></extension>',
    "no model may attach itself": '<asset><model file="m.xml"/></asset>',
    "takes more than 2 GB": SKY,
    "bomb": PICTURE,
    "size (800,": '<size nuserdata="100000000"/>',
    "option timestep=-1: wanted": '<option timestep="-1"/>',
    "option timestep=0: wanted": '<option timestep="0"/>',
    "option timestep=0.2: wanted": '<option timestep="0.2"/>',
    "option timestep=nan: wanted": '<option timestep="nan"/>',
    "option timestep=inf: wanted": '<option timestep="inf"/>',
    "option iterations: at most": '<option iterations="1000000000" tolerance="0"/>',
    "gravity: not finite": '<option gravity="0 0 nan"/>',
    "wind: not finite": '<option wind="-Infinity 0 0"/>',
    "body_inertia: not finite": '<worldbody><body><joint/><geom size="1" mass="inf"/></body></worldbody>',
    "range: not finite": '<worldbody><body><joint range="nan 1"/><geom size="1"/></body></worldbody>',
    "meanmass: not finite": '<statistic meanmass="inf"/>',
    "degrees of freedom (nv=207)": "<worldbody>"
    + '<body><freejoint/><geom size=".1"/></body>' * 34
    + "</worldbody>",
}


@pytest.mark.parametrize("fault", REFUSALS)
def test_what_cannot_be_simulated_is_refused_by_name(tmp_path, fault):
    unnamed = BODY.replace(' name="b"', "")
    body = unnamed.replace(
        "<joint", '<joint type="slide" axis="1 0 0"/><joint axis="0 1 0"/><joint axis="1 0 0"'
    )
    main = write(tmp_path, {"m.xml": mujoco_xml(REFUSALS[fault], body), "bomb.png": PNG})
    assert fault in refusal(main)


def test_a_model_that_takes_too_long_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(compiled_model, "COMPILING", ProcessLimits(memory=2**31, seconds=3))
    copies = '<worldbody><replicate count="1000000"><site/></replicate></worldbody>'
    assert "takes more than 3 s" in refusal(write(tmp_path, {"m.xml": mujoco_xml(copies)}))


def test_a_model_is_compiled_where_no_file_can_be_opened(tmp_path):
    """Whatever the reader of the names missed: the process that compiles has the files in memory, and no others."""
    secret = write(tmp_path, {"secret.xml": mujoco_xml()})
    text = f'<mujoco><include file="{secret}"/></mujoco>'
    request = compiled_model.ModelRequest("m.xml", Documents(text, False, {}, {}))
    with pytest.raises(BadFileError, match="Empty file"):
        call_limited(compiled_model.compile_here, request, compiled_model.COMPILING)
    assert compiled_model.compile_here(request)


@pytest.mark.parametrize("size", ['memory="10K"', 'memory="1T"', 'njmax="9" nconmax="3"'])
def test_mujocos_working_memory_is_what_we_say_not_the_model(tmp_path, size):
    main = write(tmp_path, {"m.xml": mujoco_xml(f"<size {size}/>")})
    assert compile_model(read_model_files(main)).narena == MEMORY_LIMIT


def test_a_model_loaded_again_starts_no_process(tmp_path):
    files = read_model_files(write(tmp_path, {"m.xml": mujoco_xml("<!-- again -->")}))
    first = compile_model(files)
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    again = compile_model(ModelFiles.from_json(files.to_json()))
    assert resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime == before.ru_utime
    first.opt.timestep = 0.01
    assert again.opt.timestep != first.opt.timestep


def test_a_model_without_joints_is_refused(tmp_path):
    assert "no joints" in refusal(write(tmp_path, {"m.xml": "<mujoco><worldbody/></mujoco>"}))


def test_what_mujoco_refuses_is_one_line(tmp_path):
    main = write(tmp_path, {"m.xml": mujoco_xml("<foo/>")})
    assert refusal(main).startswith(
        "m.xml: XML Error: Schema violation: unrecognized element Element 'foo'"
    )


@pytest.mark.parametrize(
    "value", [None, [], {}, {"main": "m.xml", "files": {"m.xml": 1}}, {"main": 1, "files": {}}]
)
def test_json_of_another_kind_is_refused(value):
    with pytest.raises(BadFileError, match="main, files"):
        ModelFiles.from_json(value)


@pytest.mark.parametrize("text", ["%", "PA"])
def test_damaged_files_are_refused(text):
    with pytest.raises(BadFileError, match="m.xml"):
        ModelFiles.from_json({"main": "m.xml", "files": {"m.xml": text}})


def test_a_file_that_differs_is_named(tmp_path):
    files = read_model_files(good_model(tmp_path))
    assert files.differences(files.digests) == []
    (tmp_path / "meshes/tip.STL").write_bytes(stl(3))
    (tmp_path / "parts/arm.xml").write_text(
        '<mujocoinclude><body name="arm"><joint/><geom type="mesh" mesh="two"/></body></mujocoinclude>'
    )
    assert read_model_files(tmp_path / "robot.xml").differences(files.digests) == [
        "meshes/tip.STL",
        "parts/arm.xml",
    ]


def test_a_process_that_compiles_a_model_imports_nothing_that_checks_definitions():
    """It is started for each model somebody brings: half of its time went into such imports."""
    code = "import sys, neuroanimator.systems.model_files; print('pydantic' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout == "False\n", done.stderr
