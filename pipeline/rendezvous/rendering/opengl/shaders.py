"""GLSL sources of the passes.

All passes read one table of instances with a row of `ROW_TEXELS` texels each: three rows of T_w; colour and
metallic; roughness, layer of the texture array (-1 for none), side of one repeat [m] and id.
"""

from rendezvous.rendering.scene import MAX_LIGHTS, MAX_SHADOWS

ROW_TEXELS = 5
SHADOW_PX = 1024
EDGE_SAMPLES = 2  # samples across and down a pixel on an edge, against aliasing

_HEADER = "#version 330 core\n"

_PLACE = f"""
layout(location = 0) in vec3 position;
uniform samplerBuffer instances;
layout(location = 5) in uint row;
uniform mat4 T_clip_w;
invariant gl_Position;  // passes must agree to the last bit on what is nearest

vec4 texel(int i) {{ return texelFetch(instances, {ROW_TEXELS} * int(row) + i); }}

vec3 placed(vec3 p) {{
    vec4 h = vec4(p, 1.0);
    return vec3(dot(texel(0), h), dot(texel(1), h), dot(texel(2), h));
}}
"""

ID_VERTEX = f"""{_HEADER}{_PLACE}
flat out int id;
void main() {{
    id = int(texel(4).w);
    gl_Position = T_clip_w * vec4(placed(position), 1.0);
}}
"""

ID_FRAGMENT = f"""{_HEADER}
flat in int id;
layout(location = 0) out int pixel_id;
void main() {{ pixel_id = id; }}
"""

DEPTH_FRAGMENT = f"""{_HEADER}
void main() {{ }}
"""

SURFACE_VERTEX = f"""{_HEADER}{_PLACE}
layout(location = 1) in vec3 normal;
layout(location = 2) in vec2 uv;
layout(location = 3) in vec3 colour;
layout(location = 4) in float has_uv;
out vec3 p_w;
out vec3 normal_w;
out vec3 texture_p;  // in repeats of the texture
out vec3 texture_normal;
out vec3 tint;
flat out vec4 colour_metallic;
flat out vec2 roughness_layer;
void main() {{
    bool own_uv = has_uv > 0.5;
    p_w = placed(position);
    gl_Position = T_clip_w * vec4(p_w, 1.0);
    mat3 R_S = transpose(mat3(texel(0).xyz, texel(1).xyz, texel(2).xyz));
    vec3 size = vec3(length(R_S[0]), length(R_S[1]), length(R_S[2]));
    normal_w = R_S * (normal / (size * size));
    vec4 last = texel(4);
    // A mesh without UVs is textured along its axes, at a scale that stretching does not change.
    texture_p = own_uv ? vec3(uv, 0.0) : position * size / last.z;
    texture_normal = own_uv ? vec3(0.0, 0.0, 1.0) : normal;
    colour_metallic = texel(3);
    roughness_layer = last.xy;
    tint = colour;
}}
"""

_SHADE = f"""
const float PI = 3.14159265;
const float STRETCH = 3.0;
in vec3 p_w;
in vec3 normal_w;
in vec3 texture_p;
in vec3 texture_normal;
in vec3 tint;
flat in vec4 colour_metallic;
flat in vec2 roughness_layer;
uniform sampler2DArray textures;
uniform sampler2DShadow shadow_0;
uniform sampler2DShadow shadow_1;
uniform mat4 T_shadow_w[{MAX_SHADOWS}];
uniform vec3 camera_w;
uniform vec3 ambient;
uniform vec4 contact;  // where the robot stands and its radius [m]; 0 for no robot
uniform int light_count;
uniform vec4 light_place[{MAX_LIGHTS}];      // position; w = 0 for a directional light
uniform vec4 light_direction[{MAX_LIGHTS}];  // from the light; w = cosine of the cone, -1 for none
uniform vec4 light_colour[{MAX_LIGHTS}];     // with the intensity
layout(location = 0) out vec4 pixel;

vec3 texture_colour(float layer) {{
    // Gradients of the continuous position: otherwise a line would show where the axes change.
    vec3 dx = dFdx(texture_p), dy = dFdy(texture_p), along = abs(texture_normal);
    vec2 at = texture_p.xy, at_dx = dx.xy, at_dy = dy.xy;
    if (along.x > along.y && along.x > along.z) {{ at = texture_p.yz; at_dx = dx.yz; at_dy = dy.yz; }}
    else if (along.y > along.z) {{ at = texture_p.xz; at_dx = dx.xz; at_dy = dy.xz; }}
    // On a floor at a grazing angle, the coarser direction would blur the other. True anisotropic filtering
    // would raise the time of a picture from 90 to 156 ms on the CPU.
    float a = dot(at_dx, at_dx) + 1e-12, b = dot(at_dy, at_dy) + 1e-12;
    at_dx *= min(1.0, STRETCH * sqrt(b / a));
    at_dy *= min(1.0, STRETCH * sqrt(a / b));
    return textureGrad(textures, vec3(at, layer), at_dx, at_dy).rgb;
}}

float lit(sampler2DShadow map, mat4 T_map_w, vec3 n) {{
    // Looked up slightly off the surface, so that it does not shadow itself.
    vec4 h = T_map_w * vec4(p_w + 0.006 * n, 1.0);
    vec3 at = 0.5 * h.xyz / h.w + 0.5;
    if (any(lessThan(at, vec3(0.0))) || any(greaterThan(at, vec3(1.0)))) return 1.0;
    float sum = 0.0;
    for (int i = 0; i < 4; i++) {{
        vec3 tap = at + vec3(vec2(float(i & 1) - 0.5, float(i >> 1) - 0.5) * {1.4 / SHADOW_PX:.6f}, 0.0);
        sum += texture(map, tap);
    }}
    return 0.25 * sum;
}}

// glTF's metallic-roughness model: Lambert, and GGX with Schlick's Fresnel and Hammon's joint visibility.
vec3 reflected(vec3 n, vec3 v, vec3 l, vec3 matt, vec3 f0, float alpha) {{
    float nl = clamp(dot(n, l), 0.0, 1.0);
    float nv = clamp(dot(n, v), 1e-3, 1.0);
    vec3 h = normalize(l + v);
    float nh = clamp(dot(n, h), 0.0, 1.0);
    float vh = clamp(dot(v, h), 0.0, 1.0);
    float d = nh * nh * (alpha * alpha - 1.0) + 1.0;
    float spread = alpha * alpha / (PI * d * d);
    float visible = 0.5 / mix(2.0 * nl * nv + 1e-4, nl + nv, alpha);
    float grazing = 1.0 - vh;
    float grazing_2 = grazing * grazing;
    vec3 fresnel = f0 + (1.0 - f0) * (grazing_2 * grazing_2 * grazing);
    return nl * ((1.0 - fresnel) * matt / PI + fresnel * (spread * visible));
}}

vec3 light(int i, vec3 n, vec3 v, vec3 matt, vec3 f0, float alpha) {{
    vec3 to_light = light_place[i].xyz - p_w;
    float distance_2 = max(dot(to_light, to_light), 0.01);
    bool parallel = light_place[i].w == 0.0;
    vec3 l = parallel ? -light_direction[i].xyz : to_light * inversesqrt(distance_2);
    float cone = light_direction[i].w;
    float across = dot(-l, light_direction[i].xyz);
    float inside = cone > -1.0 ? smoothstep(cone, mix(cone, 1.0, 0.35), across) : 1.0;
    float falloff = parallel ? 1.0 : inside / distance_2;
    return falloff * light_colour[i].rgb * reflected(n, v, l, matt, f0, alpha);
}}

// Share of the ambient light that reaches the ground under the robot: without it, the robot seems to float.
float open_sky(vec3 n) {{
    vec3 off = abs(p_w - contact.xyz) / max(contact.w, 1e-6);
    float under = (1.0 - smoothstep(0.5, 1.3, length(off.xy))) * (1.0 - smoothstep(0.0, 0.1, off.z));
    return 1.0 - 0.7 * under * max(n.z, 0.0);
}}

void main() {{
    vec3 base = colour_metallic.rgb * tint;
    if (roughness_layer.y >= 0.0) base *= texture_colour(roughness_layer.y);
    float metallic = colour_metallic.a;
    float roughness = max(roughness_layer.x, 0.08);
    float alpha = roughness * roughness;
    vec3 matt = base * (1.0 - metallic);
    vec3 f0 = mix(vec3(0.04), base, metallic);
    vec3 n = normalize(normal_w);
    vec3 v = normalize(camera_w - p_w);
    // Ambient light, a little stronger from above; metal mirrors it.
    vec3 sum = ambient * (matt * (0.8 + 0.2 * n.z) + f0 * (0.7 + 0.3 * reflect(-v, n).z));
    for (int i = SHADOWS; i < light_count; i++) sum += light(i, n, v, matt, f0, alpha);
    sum *= open_sky(n);
    SHADOWED_LIGHTS
    pixel = vec4(pow(min(sum, 1.0), vec3(1.0 / 2.2)), 1.0);
}}
"""

MASK_VERTEX = f"""{_HEADER}
void main() {{ gl_Position = vec4(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0, -1.0, 1.0); }}
"""

MASK_FRAGMENT = f"""{_HEADER}
uniform sampler2D mask;
void main() {{ if (texelFetch(mask, ivec2(gl_FragCoord.xy) / {EDGE_SAMPLES}, 0).r > 0.0) discard; }}
"""


def surface_fragment(*, shadows: int) -> str:
    """The surface shader for lights of which the first `shadows` cast shadows.

    One shader for each number: on the CPU, code for shadows costs time even for lights without any.
    """
    lit = "\n    ".join(
        f"sum += lit(shadow_{i}, T_shadow_w[{i}], n) * light({i}, n, v, matt, f0, alpha);"
        for i in range(shadows)
    )
    return _HEADER + _SHADE.replace("SHADOWED_LIGHTS", lit).replace("SHADOWS", str(shadows))
