#!/usr/bin/env bash
# Guess: UsdGeom.BBoxCache.SetTime(t) gives the boxes that a new cache made for t gives, for every prim that moves.
#
# Seen instead: the box of a SkelRoot without an authored extent stays that of the first time asked for, though its joints move
# and a new cache has the right box at each time. A prim moved by its transform follows. An extent with a value for each time
# on the SkelRoot is read anew, and mends it.
#
# Why it matters: framing and culling take boxes from one such cache. A character whose bones walk 10 m away, as in files made
# from motion capture, is framed where it was at first. Exporters should write extents of SkelRoots.
#
# Versions: usd-core 26.11, Python 3.11.
set -euo pipefail

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet usd-core==26.11
venv/bin/python - <<'PYTHON'
import sys

from pxr import Gf, Usd, UsdGeom, UsdSkel, Vt

POINTS = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]
ONE = Vt.Matrix4dArray([Gf.Matrix4d(1)])
END, AWAY = 10, 10.0

stage = Usd.Stage.CreateInMemory()


def mesh_at(path):
    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreatePointsAttr(POINTS)
    mesh.CreateFaceVertexCountsAttr([3])
    mesh.CreateFaceVertexIndicesAttr([0, 1, 2])
    mesh.CreateExtentAttr([(0, 0, 0), (1, 1, 0)])
    return mesh


def skinned(path):
    root = UsdSkel.Root.Define(stage, path)
    rig = UsdSkel.Skeleton.Define(stage, path + "/rig")
    motion = UsdSkel.Animation.Define(stage, path + "/motion")
    for joints in (rig.CreateJointsAttr(), motion.CreateJointsAttr()):
        joints.Set(["hip"])
    rig.CreateBindTransformsAttr(ONE)
    rig.CreateRestTransformsAttr(ONE)
    motion.CreateRotationsAttr([Gf.Quatf(1)])
    motion.CreateScalesAttr([Gf.Vec3h(1)])
    places = motion.CreateTranslationsAttr()
    places.Set([(0, 0, 0)], 0)
    places.Set([(AWAY, 0, 0)], END)
    UsdSkel.BindingAPI.Apply(rig.GetPrim()).CreateAnimationSourceRel().SetTargets([motion.GetPath()])
    mesh = mesh_at(path + "/mesh")
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    binding.CreateSkeletonRel().SetTargets([rig.GetPath()])
    binding.CreateJointIndicesPrimvar(True, 1).Set([0])
    binding.CreateJointWeightsPrimvar(True, 1).Set([1.0])
    return root


def least_x(prim, times, *, is_new):
    found = []
    cache = UsdGeom.BBoxCache(Usd.TimeCode(times[0]), ["default"])
    for time in times:
        if is_new:
            cache = UsdGeom.BBoxCache(Usd.TimeCode(time), ["default"])
        else:
            cache.SetTime(Usd.TimeCode(time))
        found.append(cache.ComputeWorldBound(prim).ComputeAlignedRange().GetMin()[0])
    return found


plain, mended = skinned("/plain"), skinned("/mended")
for time in (0, END):
    box = UsdGeom.Boundable.ComputeExtentFromPlugins(mended, Usd.TimeCode(time))
    mended.CreateExtentAttr().Set(box, time)
moved = mesh_at("/moved")
track = UsdGeom.Xformable(moved).AddTranslateOp()
track.Set((0, 0, 0), 0)
track.Set((AWAY, 0, 0), END)

print("usd-core", ".".join(map(str, Usd.GetVersion())))
is_as_seen = True
for name, prim, follows in (("skin", plain, False), ("skin with an extent", mended, True), ("moved mesh", moved, True)):
    kept = least_x(prim.GetPrim(), (0, END), is_new=False)
    new = least_x(prim.GetPrim(), (0, END), is_new=True)
    print(f"{name}: least x of the box at 0 and {END}: one cache {kept}, new caches {new}")
    is_as_seen &= abs(new[1] - new[0] - AWAY) < 1 and (abs(kept[1] - kept[0] - AWAY) < 1) == follows
sys.exit(0 if is_as_seen else "This has changed: look at what the cache does now.")
PYTHON
