# SPDX-License-Identifier: Apache-2.0
"""Plastics and metals of the object."""
import bpy
PLASTIC = {  # linear RGB, roughness, metallic
    "yellow": ((0.80, 0.42, 0.02), 0.22, 0),
    "orange": ((0.75, 0.16, 0.02), 0.25, 0),
    "red": ((0.50, 0.02, 0.02), 0.20, 0),
    "blue": ((0.02, 0.08, 0.40), 0.20, 0),
    "green": ((0.03, 0.22, 0.06), 0.30, 0),
    "sand": ((0.45, 0.35, 0.22), 0.45, 0),
    "white": ((0.75, 0.75, 0.72), 0.25, 0),
    "grey": ((0.20, 0.21, 0.22), 0.35, 0),
    "dark": ((0.035, 0.035, 0.04), 0.30, 0),
    "glass": ((0.01, 0.02, 0.03), 0.05, 0),
    "chrome": ((0.80, 0.80, 0.82), 0.18, 1),
    "brass": ((0.70, 0.48, 0.18), 0.25, 1),
}


def material(name):
    """The sun by Blender's own shader; sky and ground as emission of normal and mirrored view, which costs no ray and has no noise."""
    if name in bpy.data.materials:
        return bpy.data.materials[name]
    color, roughness, metallic = PLASTIC[name]
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    tree = made.node_tree
    shader, out = tree.nodes["Principled BSDF"], tree.nodes["Material Output"]
    shader.inputs["Base Color"].default_value = (*color, 1)
    shader.inputs["Roughness"].default_value = roughness
    shader.inputs["Metallic"].default_value = metallic

    def node(kind, *inputs, **settings):
        new = tree.nodes.new(kind)
        for key, value in settings.items():
            setattr(new, key, value)
        for i, value in enumerate(inputs):
            if isinstance(value, bpy.types.NodeSocket):
                tree.links.new(value, new.inputs[i])
            else:
                new.inputs[i].default_value = value
        return new

    def scaled(vector, factor):
        return node("ShaderNodeVectorMath", vector, (0, 0, 0), (0, 0, 0), factor, operation="SCALE").outputs[0]

    def light_from(direction):
        """Interpolates between ground and sky by height."""
        z = node("ShaderNodeSeparateXYZ", direction).outputs[2]
        up = node("ShaderNodeMapRange", z, -1.0, 1.0, 0.0, 1.0).outputs[0]
        return node("ShaderNodeMixRGB", up, (0.14, 0.12, 0.10, 1), (0.60, 0.66, 0.72, 1)).outputs[0]

    seen = node("ShaderNodeNewGeometry").outputs
    normal, to_eye = seen["Normal"], seen["Incoming"]
    from_eye = scaled(to_eye, -1.0)
    mirrored = node("ShaderNodeVectorMath", from_eye, normal, operation="REFLECT").outputs[0]
    base = node("ShaderNodeRGB").outputs[0]
    base.default_value = (*color, 1)
    diffuse = node("ShaderNodeVectorMath", base, light_from(normal), operation="MULTIPLY").outputs[0]
    if metallic:
        glossy = node("ShaderNodeVectorMath", base, light_from(mirrored), operation="MULTIPLY").outputs[0]
    else:
        fresnel = node("ShaderNodeFresnel", 1.45).outputs[0]
        glossy = scaled(scaled(light_from(mirrored), fresnel), 1.0 - roughness)
    sum_ = glossy if metallic else node("ShaderNodeVectorMath", diffuse, glossy, operation="ADD").outputs[0]
    emission = node("ShaderNodeEmission", sum_, 1.0).outputs[0]
    tree.links.new(node("ShaderNodeAddShader", shader.outputs[0], emission).outputs[0], out.inputs["Surface"])
    if hasattr(made.cycles, "sample_as_light"):
        made.cycles.sample_as_light = False
    return made
