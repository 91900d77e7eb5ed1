"""Shaders of pictures, in GLSL: what stands in a scene, the ground, and the depth that a light sees.

Colours of objects are squared before light is added and the root is drawn at the end, which comes close to sRGB; the
ground needs that only for its shade. Loops whose
number of turns depends on the pixel are there for speed: renderers on a processor go through both sides of an `if`,
but leave a loop that no pixel needs.
"""

_PLACED = """#version 330
uniform sampler2D objects;
uniform mat4 clip_from_world;
uniform mat4 light_from_world;
in vec3 position;
in vec3 normal;
in vec3 grain;
in float item;

vec3 placed() {
    int row = int(item);
    vec4 p = vec4(position, 1.0);
    return vec3(dot(texelFetch(objects, ivec2(0, row), 0), p), dot(texelFetch(objects, ivec2(1, row), 0), p),
                dot(texelFetch(objects, ivec2(2, row), 0), p));
}
"""

DEPTH_VERTEX = (
    _PLACED
    + """
void main() { gl_Position = light_from_world * vec4(placed(), 1.0); }
"""
)

DEPTH_FRAGMENT = """#version 330
void main() {}
"""

OBJECT_VERTEX = (
    _PLACED
    + """
out vec3 world;
out vec3 facing;
out vec3 lit;
out vec3 in_wood;
flat out vec4 color;
flat out vec4 cut;

void main() {
    int row = int(item);
    world = placed();
    facing = vec3(dot(texelFetch(objects, ivec2(0, row), 0).xyz, normal),
                  dot(texelFetch(objects, ivec2(1, row), 0).xyz, normal),
                  dot(texelFetch(objects, ivec2(2, row), 0).xyz, normal));
    color = texelFetch(objects, ivec2(3, row), 0);
    cut = texelFetch(objects, ivec2(4, row), 0);
    in_wood = grain;
    lit = (light_from_world * vec4(world, 1.0)).xyz * 0.5 + 0.5;
    gl_Position = clip_from_world * vec4(world, 1.0);
}
"""
)

_SHADOW = """#version 330
uniform sampler2D depths;
uniform sampler2D casters;  // where in the map anything can cast a shadow
uniform sampler2DShadow shadows;
uniform vec3 to_light;
uniform float reach;     // radius within which something can cast a soft shadow, in widths of the map
uniform float sharpest;  // the same of the sharpest edge
uniform float spread;    // widths of the map that a shadow grows per unit of depth
uniform ivec2 taps;      // samples that look for what hides a point, and samples of the edge
const mat2 golden = mat2(-0.73737, 0.67549, -0.67549, -0.73737);  // turns from one sample of a disk to the next

// Share of the light that reaches a point; soft as a lamp's, the softer the farther away what hides it is.
float brightness(vec3 at, float bias, bool faces) {
    float inside = step(max(abs(at.x - 0.5), abs(at.y - 0.5)), 0.5) * textureLod(casters, at.xy, 0.0).r;
    float hidden = 0.0, count = 0.0;
    vec2 way = vec2(1.0, 0.0);
    int search = faces ? int(inside) * taps.x : 0;
    for (int k = 0; k < search; k++) {
        way = golden * way;
        float depth = textureLod(depths, at.xy + reach * sqrt((float(k) + 0.5) / float(taps.x)) * way, 0.0).r;
        float hides = step(depth, at.z - bias);
        hidden += hides * depth;
        count += hides;
    }
    float radius = clamp((at.z - hidden / max(count, 1.0)) * spread, sharpest, reach);
    float sum = 0.0;
    int samples = count > 0.0 ? taps.y : 0;
    for (int k = 0; k < samples; k++) {
        way = golden * way;
        vec2 off = radius * sqrt((float(k) + 0.5) / float(samples)) * way;
        sum += textureLod(shadows, vec3(at.xy + off, at.z - bias), 0.0);
    }
    return samples > 0 ? sum / float(samples) : 1.0;
}
"""

OBJECT_FRAGMENT = (
    _SHADOW
    + """
uniform sampler2D wood;
uniform vec2 wood_size;
uniform vec3 eye;
uniform float bias;
in vec3 world;
in vec3 facing;
in vec3 lit;
in vec3 in_wood;
flat in vec4 color;
flat in vec4 cut;
out vec4 result;

void main() {
    vec3 normal = normalize(facing);
    vec3 view = normalize(eye - world);
    float pith = length(in_wood.yz - cut.yz - cut.w * in_wood.x * vec2(1.0, 0.4));
    float value = texture(wood, vec2(in_wood.x + cut.x, pith) / wood_size).r;
    vec3 base = mix(color.rgb, color.rgb * mix(vec3(0.40, 0.30, 0.24), vec3(1.12), value), color.a);
    float toward = dot(normal, to_light);
    float steep = bias * (1.0 + 3.0 * (1.0 - abs(toward)));
    float light = brightness(lit, steep, toward > 0.0) * smoothstep(0.0, 0.15, toward);
    vec3 around = mix(vec3(0.27, 0.25, 0.23), vec3(0.46, 0.48, 0.52), 0.5 * normal.z + 0.5);
    float front = max(dot(normal, view), 0.0);
    float gloss = pow(max(dot(normal, normalize(to_light + view)), 0.0), 40.0) * mix(0.22, 0.06, color.a);
    vec3 sum = base * (around + 0.72 * max(toward, 0.0) * light + 0.14 * front) + gloss * light;
    sum += (1.0 - front) * (1.0 - front) * (1.0 - front) * 0.05;
    result = vec4(sqrt(sum), 1.0);
}
"""
)

GROUND_VERTEX = """#version 330
uniform mat4 clip_from_world;
uniform mat4 light_from_world;
uniform float behind;  // farther than it is, so that ground with shadows hides it
in vec2 position;
out vec2 world;
out vec3 lit;

void main() {
    world = position;
    lit = (light_from_world * vec4(position, 0.0, 1.0)).xyz * 0.5 + 0.5;
    gl_Position = clip_from_world * vec4(position, 0.0, 1.0);
    gl_Position.z += behind * gl_Position.w;
}
"""

_GROUND_FRAGMENT = """
uniform vec3 ground;
uniform vec3 lines;
uniform vec3 background;
uniform vec2 middle;
uniform vec2 fade;       // distances from the middle between which the ground fades into the background
uniform float spacing;   // distance between lines
uniform float shade;     // brightness of a full shadow
in vec2 world;
in vec3 lit;
out vec4 result;

void main() {
    vec2 cell = world / spacing;
    vec2 wide = fwidth(cell);
    vec2 off = abs(fract(cell - 0.5) - 0.5) / wide;
    vec2 line = (1.0 - clamp(off - 0.15, 0.0, 1.0)) * clamp(0.25 / wide - 0.5, 0.0, 1.0);
    float far = smoothstep(fade.x, fade.y, length(world - middle));
    vec3 base = mix(ground, lines, max(line.x, line.y) * (1.0 - smoothstep(0.0, 0.6, far)));
    result = vec4(mix(base * sqrt(mix(shade, 1.0, brightness(lit, 0.0, true))), background, far), 1.0);
}
"""

SHADED_GROUND_FRAGMENT = _SHADOW + _GROUND_FRAGMENT
PLAIN_GROUND_FRAGMENT = (
    """#version 330
float brightness(vec3 at, float bias, bool faces) { return 1.0; }
"""
    + _GROUND_FRAGMENT
)
