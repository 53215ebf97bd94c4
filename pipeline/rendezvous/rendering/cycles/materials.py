"""Materials as Blender's nodes: the model of the OpenGL shaders (glTF's), by its Principled BSDF."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from rendezvous.rendering.cycles.blender import blender
from rendezvous.rendering.cycles.resident import ALONG, TINT, UV, BlenderPart, BlenderPools
from rendezvous.rendering.scene import Material

Size = tuple[float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Look:
    """What surfaces of one Blender material share.

    Attributes:
        material: the material.
        size: how far the mesh is stretched along its axes, which does not stretch a texture without UVs.
        has_uv, has_tint, open: see `BlenderPart`.
    """

    material: Material
    size: Size
    has_uv: bool
    has_tint: bool
    open: bool

    @staticmethod
    def of(part: BlenderPart, material: Material, size: Size) -> Look:
        """The look of a part; without a texture, size does not matter."""
        own_scale = material.texture is None or part.has_uv
        return Look(
            material=material,
            size=(1.0, 1.0, 1.0) if own_scale else size,
            has_uv=part.has_uv,
            has_tint=part.has_tint,
            open=part.open,
        )


def make_material(look: Look, pools: BlenderPools) -> Any:
    """A new Blender material."""
    made = blender().data.materials.new("look")
    made.use_nodes = True
    nodes = _Nodes(made.node_tree)
    material = look.material
    bsdf = nodes.add("BsdfPrincipled", Metallic=material.metallic, Roughness=material.roughness)
    bsdf.inputs["Base Color"].default_value = (*material.base_colour_rgb, 1.0)
    factors = []
    if material.texture is not None:
        image = nodes.add("TexImage", Vector=_place(nodes, look))
        image.image = pools.image(material.texture)
        factors.append(image.outputs["Color"])
    if look.has_tint:
        factors.append(nodes.attribute(TINT, "Color"))
    colour: Any = material.base_colour_rgb
    for factor in factors:
        colour = nodes.vector("MULTIPLY", factor, colour)
    if factors:
        nodes.link(colour, bsdf.inputs["Base Color"])
    surface = bsdf.outputs["BSDF"]
    if look.open:
        surface = _unseen_from_behind(nodes, surface)
    nodes.add("OutputMaterial", Surface=surface)
    return made


def _place(nodes: _Nodes, look: Look) -> Any:
    """Where in the texture a point lies: by its UVs, or along the two axes that its face faces least."""
    if look.has_uv:
        uv = nodes.add("UVMap")
        uv.uv_map = UV
        return uv.outputs["UV"]
    side_m = look.material.texture_scale_m
    at = nodes.add("TexCoord").outputs["Object"]
    x, y, z = nodes.xyz(nodes.vector("MULTIPLY", at, tuple(size / side_m for size in look.size)))
    along_x, _, along_z = nodes.xyz(nodes.attribute(ALONG, "Vector"))
    u = nodes.math("MULTIPLY_ADD", along_x, nodes.math("SUBTRACT", y, x), x)
    v = nodes.math("MULTIPLY_ADD", along_z, nodes.math("SUBTRACT", y, z), z)
    return nodes.add("CombineXYZ", X=u, Y=v).outputs["Vector"]


def _unseen_from_behind(nodes: _Nodes, surface: Any) -> Any:
    mix = nodes.add("MixShader", Fac=nodes.add("NewGeometry").outputs["Backfacing"])
    nodes.link(surface, mix.inputs[1])
    nodes.link(nodes.add("BsdfTransparent").outputs["BSDF"], mix.inputs[2])
    return mix.outputs["Shader"]


class _Nodes:
    """A tree of nodes; what is given for an input is a value, or another node's output."""

    def __init__(self, tree: Any) -> None:
        self._tree = tree
        tree.nodes.clear()

    def add(self, kind: str, **inputs: Any) -> Any:
        node = self._tree.nodes.new(f"ShaderNode{kind}")
        for name, value in inputs.items():
            self._give(node.inputs[name], value)
        return node

    def link(self, output: Any, into: Any) -> None:
        self._tree.links.new(output, into)

    def attribute(self, name: str, output: str) -> Any:
        node = self.add("Attribute")
        node.attribute_name = name
        return node.outputs[output]

    def vector(self, operation: str, *values: Any) -> Any:
        return self._computed("VectorMath", operation, values).outputs["Vector"]

    def math(self, operation: str, *values: Any) -> Any:
        return self._computed("Math", operation, values).outputs["Value"]

    def xyz(self, vector: Any) -> tuple[Any, Any, Any]:
        outputs = self.add("SeparateXYZ", Vector=vector).outputs
        return outputs["X"], outputs["Y"], outputs["Z"]

    def _computed(self, kind: str, operation: str, values: tuple[Any, ...]) -> Any:
        node = self.add(kind)
        node.operation = operation
        for into, value in zip(node.inputs, values, strict=False):
            self._give(into, value)
        return node

    def _give(self, into: Any, value: Any) -> None:
        if isinstance(value, float | int | tuple):
            into.default_value = value
        else:
            self.link(value, into)
