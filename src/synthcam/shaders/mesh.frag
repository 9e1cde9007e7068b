#version 330 core
// Mirror spheres on a dark plate in a dim room, without the lamp: its images are point-like and added apart.
// All lengths are in radii of the ball drawn, from its centre, on the camera's axes: single precision is then
// good to 1e-6 radii, where a hit computed from the camera would lose three digits.

uniform sampler2D others; // one row an instance: neighbours' centres and radii
uniform vec3 up;          // the plate's normal
uniform vec3 lamp;        // from the centre of the plate's quad
// SCENE is 0 for bodies on an even plate, 1 for bodies and their images in the plate, 2 for what they take from its
// light: programs of their own, for software OpenGL runs every branch there is.
uniform float gloss;      // reflectance of the plate
uniform float zenith;     // radiance of the room overhead
uniform float steel;      // reflectance at normal incidence, by Schlick's law
uniform vec2 metal;       // or n and k

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

// What follows the neighbours in their row: the plate's depth under the centre, unused, the number of lamps; then for
// each lamp its place and radius, and its share of the light. A neighbour of negative radius comes before this ball.
vec4 note(int k) {
    return texelFetch(others, ivec2(int(rest.x) + k, int(rest.z)), 0);
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
#ifdef METAL
    float square = cosine * cosine, sine = 1.0 - square;
    float t = metal.x * metal.x - metal.y * metal.y - sine;
    float both = sqrt(t * t + 4.0 * metal.x * metal.x * metal.y * metal.y);
    float a = 2.0 * cosine * sqrt((both + t) / 2.0);
    float rest = both * square + sine * sine;
    float across = (both + square - a) / (both + square + a);
    return across * (1.0 + (rest - a * sine) / (rest + a * sine)) / 2.0;
#else
    return steel + (1.0 - steel) * pow(clamp(1.0 - cosine, 0.0, 1.0), 5.0);
#endif
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

#if SCENE > 0
// Radiance that comes back along a ray which meets a ball at `near`.
float seen(vec3 from, vec3 way, float near, int here) {
    int neighbours = int(rest.x);
    vec3 point = from + near * way;
    float kept = 1.0;
    for (int bounce = 0; bounce < 4 && here != NOBODY; bounce++) {
        vec4 hit = ball(here);
        vec3 normal = (point - hit.xyz) / hit.w;
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
        if (here != NOBODY) point += near * way;
    }
    return kept * radiance(way);
}

// Share of a sample that a ball covers: its outline is a ramp one sample wide. inset: the way to the middle of what
// is covered.
float cover(vec3 from, vec3 way, vec4 sphere, out vec3 inset) {
    vec3 offset = sphere.xyz - from;
    offset -= dot(offset, way) * way;
    float miss = length(offset), wide = length(vec2(dFdx(miss), dFdy(miss)));
    float share = clamp((sphere.w - miss) / wide + 0.5, 0.0, 1.0);
    inset = share < 1.0 ? offset / miss * (miss - sphere.w + share * wide / 2.0) : vec3(0.0);
    return share;
}

// Distance to a ball along a ray that hits it, or passes it so closely that the sample is partly covered.
float touch(vec3 from, vec3 way, vec4 sphere) {
    vec3 offset = from - sphere.xyz;
    float b = dot(offset, way);
    return -b - sqrt(max(b * b - dot(offset, offset) + sphere.w * sphere.w, 0.0));
}

// Bodies with soft outlines, less the mirrored room they hide, and their mirror images in the plate.
float body_and_image(vec3 from, vec3 way) {
    int neighbours = int(rest.x);
    vec3 inset, unused;
    float own = cover(from, way, ball(SELF), inset), open = 1.0 - own;
    float near = touch(from, way, ball(SELF));
    for (int k = 0; k < neighbours; k++) {
        float share = cover(from, way, ball(k), unused);
        open *= 1.0 - share;
        if (touch(from, way, ball(k)) < near) own *= 1.0 - share;
    }
    vec3 back = reflect(way, up);
    float room = gloss * radiance(back);
    float value = own > 0.0 ? own * (seen(from + inset, way, touch(from + inset, way, ball(SELF)), SELF) - room) : 0.0;
    if (gloss > 0.0 && open > 0.0) {
        vec3 at = from - way * (dot(from, up) + note(0).x) / dot(way, up);
        float hit = entry(at, back, ball(SELF));
        for (int k = 0; k < neighbours; k++) {
            float far = entry(at, back, ball(k));
            if (far > 0.0 && far < hit) hit = NOTHING;
        }
        if (hit != NOTHING && hit > 0.0) value += open * (gloss * seen(at, back, hit, SELF) - room);
    }
    return value;
}

// Share of a lamp's disc that a ball leaves in view: circles of angular radii a and b, t apart.
float left_of(float a, float b, float t) {
    if (t >= a + b) return 1.0;
    if (t <= b - a) return 0.0;
    if (t <= a - b) return 1.0 - b * b / (a * a);
    float u = acos(clamp((t * t + a * a - b * b) / (2.0 * t * a), -1.0, 1.0));
    float v = acos(clamp((t * t + b * b - a * a) / (2.0 * t * b), -1.0, 1.0));
    float both = a * a * (u - sin(u) * cos(u)) + b * b * (v - sin(v) * cos(v));
    return 1.0 - both / (3.14159265 * a * a);
}

// Share of the plate's light that a ball lets through to the eye.
float passed(vec3 from, vec3 way, vec3 at, vec4 sphere) {
    float light = note(0).z == 0.0 ? 1.0 : 0.0;
    vec3 offset = sphere.xyz - at;
    float far = length(offset);
    for (int k = 0; k < int(note(0).z); k++) {
        vec4 place = note(1 + 2 * k);
        vec3 to_lamp = place.xyz - at;
        float range = length(to_lamp);
        float apart = acos(clamp(dot(offset, to_lamp) / (far * range), -1.0, 1.0));
        float wide = asin(clamp(sphere.w / far, 0.0, 1.0));
        light += note(2 + 2 * k).x * left_of(place.w / range, wide, apart);
    }
    vec3 unused;
    return light * (1.0 - cover(from, way, sphere, unused));
}

// Balls in a fixed order, each times what those before it let through: the sum over all of them is their product's.
float shade(vec3 from, vec3 way) {
    vec3 at = from - way * (dot(from, up) + note(0).x) / dot(way, up);
    float before = 1.0;
    for (int k = 0; k < int(rest.x); k++) {
        vec4 sphere = ball(k);
        if (sphere.w < 0.0) before *= passed(from, way, at, vec4(sphere.xyz, -sphere.w));
    }
    return before * (passed(from, way, at, ball(SELF)) - 1.0);
}
#else
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
#endif

void main() {
    // In this order the first difference is exact, and a body the same wherever its tile lies.
    vec2 sample_at = (gl_FragCoord.xy - place.xy) - place.zw;
    vec3 from = vec3(lens.xy * sample_at.x + lens.zw * sample_at.y, 0.0);
    vec3 way = normalize(from - eye.xyz);
#if SCENE == 0
    float value = rest.x < 0.0 ? lit_plate(from, way) : body(from, way);
#elif SCENE == 1
    float value = body_and_image(from, way);
#else
    float value = shade(from, way);
#endif
    picture = vec4(eye.w * value);
}
