# SPDX-License-Identifier: Apache-2.0
"""Shader node graphs, written as expressions. Texture coordinates are metres."""
import bpy


class Shader:
    """One material. Colours are sockets or (r, g, b); every method returns a socket, the last ones the material."""

    def __init__(self, name, flat):
        self.material = bpy.data.materials.new(name)
        self.material.use_nodes = True
        self.tree = self.material.node_tree
        self.tree.nodes.clear()
        self.flat = flat

    def node(self, kind, inputs=None, **properties):
        node = self.tree.nodes.new("ShaderNode" + kind)
        for key, value in properties.items():
            setattr(node, key, value)
        for key, value in (inputs or {}).items():
            self.connect(value, node.inputs[key])
        return node

    def connect(self, value, socket):
        if isinstance(value, bpy.types.NodeSocket):
            self.tree.links.new(value, socket)
        elif isinstance(value, (tuple, list)) and len(socket.default_value) == 4:
            socket.default_value = (*value[:3], 1)
        else:
            socket.default_value = value

    def uv(self, scale=(1, 1, 1)):
        at = self.node("TexCoord").outputs["UV"]
        return at if scale == (1, 1, 1) else self.node("Mapping", {"Vector": at, "Scale": scale}).outputs["Vector"]

    def noise(self, at, scale, detail=2, roughness=0.55):
        return self.node("TexNoise", {"Vector": at, "Scale": scale, "Detail": detail, "Roughness": roughness}).outputs[
            "Fac"
        ]

    def warped(self, at, scale, detail):
        """Returns at + noise, for irregular cracks."""
        noise = self.node("TexNoise", {"Vector": at, "Scale": scale, "Detail": detail}).outputs["Color"]
        return self.node("VectorMath", {0: at, 1: noise}, operation="ADD").outputs[0]

    def voronoi(self, at, scale, feature):
        return self.node("TexVoronoi", {"Vector": at, "Scale": scale}, feature=feature)

    def brick(self, at, color1, color2, mortar, width, height, joint):
        return self.node(
            "TexBrick",
            {
                "Vector": at,
                "Color1": color1,
                "Color2": color2,
                "Mortar": mortar,
                "Scale": 1.0,
                "Brick Width": width,
                "Row Height": height,
                "Mortar Size": joint,
                "Mortar Smooth": 0.1,
            },
        ).outputs["Color"]

    def ramp(self, value, to_low, to_high, low=0.3, high=0.7):
        return self.node(
            "MapRange",
            {"Value": value, "From Min": low, "From Max": high, "To Min": to_low, "To Max": to_high},
            clamp=True,
        ).outputs["Result"]

    def maximum(self, a, b):
        return self.node("Math", {0: a, 1: b}, operation="MAXIMUM").outputs[0]

    def times(self, color, factor):
        return self.node("VectorMath", {0: color, "Scale": factor}, operation="SCALE").outputs[0]

    def mix(self, factor, a, b):
        return self.node("MixRGB", {0: factor, 1: a, 2: b}).outputs[0]

    def _mix_shaders(self, factor, a, b):
        return self.node("MixShader", {0: factor, 1: a, 2: b}).outputs[0]

    def _finish(self, shader):
        """Evaluates textures for camera rays alone; bounced light gets one flat shade."""
        flat = self.node("BsdfDiffuse", {"Color": self.flat}).outputs[0]
        seen = self.node("LightPath").outputs["Is Camera Ray"]
        self.node("OutputMaterial", {0: self._mix_shaders(seen, flat, shader)})
        return self.material

    def diffuse(self, color):
        return self._finish(self.node("BsdfDiffuse", {"Color": color}).outputs[0])

    def coated(self, color, mirror=0.15, roughness=0.2, index=1.45):
        """Diffuse below a smooth coat: mirror + Fresnel(index) of the light is reflected."""
        fresnel = self.node("Fresnel", {0: index}).outputs[0]
        share = self.node("Math", {0: fresnel, 1: mirror}, operation="ADD", use_clamp=True).outputs[0]
        below = self.node("BsdfDiffuse", {"Color": color}).outputs[0]
        coat = self.node("BsdfGlossy", {"Color": (1, 1, 1), "Roughness": roughness}).outputs[0]
        return self._finish(self._mix_shaders(share, below, coat))

    def leaf(self, color, through=0.3):
        front = self.node("BsdfDiffuse", {"Color": color}).outputs[0]
        return self._finish(
            self._mix_shaders(through, front, self.node("BsdfTranslucent", {"Color": color}).outputs[0])
        )
