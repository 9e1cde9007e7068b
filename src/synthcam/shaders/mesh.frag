#version 330 core
// Mirror spheres on a dark plate in a dim room, without the lamp: its images are point-like and added apart.
// All lengths are in radii of the ball drawn, from its centre, on the camera's axes: single precision is then
// good to 1e-6 radii, where a hit computed from the camera would lose three digits.

uniform sampler2D others; // one row an instance: neighbours' centres and radii
uniform vec3 up;          // the plate's normal
uniform vec3 lamp;        // from the centre of the plate's quad
uniform float zenith;     // radiance of the room overhead
uniform float steel;      // reflectance at normal incidence, by Schlick's law
uniform vec2 metal;       // n and k; n = 0: Schlick's law

flat in vec4 place;
flat in vec4 lens;
flat in vec4 eye;
flat in vec4 rest;

out vec4 picture;

const float NOTHING = 1e9;
const int SELF = -1;
const int NOBODY = -2;

vec4 ball(int k) {
    return k == SELF ? vec4(0.0, 0.0, 0.0, 1.0) : texelFetch(others, ivec2(k, int(rest.z)), 0);
}

// Distance along the line at which it enters the sphere.
float entry(vec3 from, vec3 way, vec4 sphere) {
    vec3 offset = from - sphere.xyz;
    float b = dot(offset, way);
    float h = b * b - dot(offset, offset) + sphere.w * sphere.w;
    return h > 0.0 ? -b - sqrt(h) : NOTHING;
}

// Schlick 1994, Comput. Graph. Forum 13; or Fresnel's laws for a metal, Born & Wolf, Principles of Optics, 14.2.
float mirror(float cosine) {
    if (metal.x > 0.0) {
        float square = cosine * cosine, sine = 1.0 - square;
        float t = metal.x * metal.x - metal.y * metal.y - sine;
        float both = sqrt(t * t + 4.0 * metal.x * metal.x * metal.y * metal.y);
        float a = 2.0 * cosine * sqrt((both + t) / 2.0);
        float rest = both * square + sine * sine;
        float across = (both + square - a) / (both + square + a);
        return across * (1.0 + (rest - a * sine) / (rest + a * sine)) / 2.0;
    }
    return steel + (1.0 - steel) * pow(clamp(1.0 - cosine, 0.0, 1.0), 5.0);
}

// Room: brightest overhead, fading into the plate at the horizon.
float radiance(vec3 way) {
    return mix(rest.w, zenith, max(dot(way, up), 0.0));
}

float lit_plate(vec3 from, vec3 way) {
    vec3 to_lamp = lamp - (from - way * dot(from, up) / dot(way, up));
    float square = dot(to_lamp, to_lamp);
    float height = dot(to_lamp, up);
    return rest.w * height * height / (square * square);
}

float body(vec3 from, vec3 way) {
    int neighbours = int(rest.x);
    float near = entry(from, way, ball(SELF));
    if (near == NOTHING) return 0.0;
    for (int k = 0; k < neighbours; k++)
        if (entry(from, way, ball(k)) < near) return 0.0;

    vec3 point = from + near * way;
    vec3 normal = point;
    int here = SELF;
    float kept = 1.0;
    for (int bounce = 0; bounce < 4 && here != NOBODY; bounce++) {
        kept *= mirror(-dot(way, normal));
        way = reflect(way, normal);
        int next = NOBODY;
        near = NOTHING;
        for (int k = SELF; k < neighbours; k++) {
            if (k == here) continue;
            float far = entry(point, way, ball(k));
            if (far > 0.0 && far < near) {
                near = far;
                next = k;
            }
        }
        here = next;
        if (here == NOBODY) break;
        point += near * way;
        normal = (point - ball(here).xyz) / ball(here).w;
    }
    return kept * radiance(way) - rest.w;
}

void main() {
    // In this order the first difference is exact, and a body the same wherever its tile lies.
    vec2 sample_at = (gl_FragCoord.xy - place.xy) - place.zw;
    vec3 from = vec3(lens.xy * sample_at.x + lens.zw * sample_at.y, 0.0);
    vec3 way = normalize(from - eye.xyz);
    float value = rest.x < 0.0 ? lit_plate(from, way) : body(from, way);
    picture = vec4(eye.w * value);
}
