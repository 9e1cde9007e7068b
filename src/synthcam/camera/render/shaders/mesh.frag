#version 330 core
// Mirror spheres on a dark plate in a dim room, without the lamp: its images are point-like and added apart.
// All lengths are in radii of the ball drawn, from its centre, on the camera's axes: single precision is then
// good to 1e-6 radii, where a hit computed from the camera would lose three digits.

uniform sampler2D others; // one row an instance: neighbours' centres and radii
uniform vec3 up;          // the plate's normal
uniform vec3 lamp;        // from the centre of the plate's quad
// SCENE is 0 for balls on an even plate, 1 for balls and their images in the plate, 2 for what they take from its
// light, 3 for the even plate itself; PAIR says that no ball has two neighbours, NEAR that none has more, APART that the
// picture shows each ball apart from the others, LONE that the ball mirrors no other either,
// INSIDE that it covers each sample wholly. Programs of their own, for software OpenGL runs every branch there is,
// and a fetch costs as much as a bounce.
uniform float gloss;      // reflectance of the plate
uniform float zenith;     // radiance of the room overhead
uniform float steel;      // reflectance at normal incidence, by Schlick's law
uniform vec2 metal;       // or n and k

flat in vec4 place;
flat in vec4 lens;
flat in vec4 eye;
flat in vec4 rest;
#ifndef NEAR
flat in vec4 nearest;
#define COUNT int(rest.x)
#else
#define COUNT NEAR
#if NEAR > 0
flat in vec4 near_by[NEAR];
#endif
#endif

out vec4 picture;

const float NOTHING = 1e9;
const int SELF = -1;
const int NOBODY = -2;

vec4 ball(int k) {
#ifdef PAIR
    vec4 neighbour = nearest;
#else
#ifdef NEAR
    vec4 neighbour = vec4(0.0);
#if NEAR > 0
    for (int j = 0; j < NEAR; j++) if (j == k) neighbour = near_by[j];
#endif
#else
    vec4 neighbour = texelFetch(others, ivec2(k, int(rest.z)), 0);
#endif
#endif
    return k == SELF ? vec4(0.0, 0.0, 0.0, 1.0) : neighbour;
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
    float slant = clamp(1.0 - cosine, 0.0, 1.0), square = slant * slant;
    return steel + (1.0 - steel) * square * square * slant;
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

// The first ball but `here` that a line enters further on than `after`, and how far on.
int next_ball(vec3 point, vec3 way, int here, float after, out float near) {
    int next = NOBODY;
    near = NOTHING;
#ifdef PAIR
    int other = here == SELF ? 0 : SELF;
    float far = entry(point, way, ball(other));
    if (rest.x > 0.0 && far > after && far < near) {
        near = far;
        next = other;
    }
#else
    for (int k = SELF; k < COUNT; k++) {
        float far = entry(point, way, ball(k));
        if (k != here && k < int(rest.x) && far > after && far < near) {
            near = far;
            next = k;
        }
    }
#endif
    return next;
}

// Radiance that comes back along a ray which meets a ball at `near`.
float seen(vec3 from, vec3 way, float near) {
    vec3 point = from + near * way;
    int here = SELF;
    float kept = 1.0;
    // Elsewhere no constant, or the loop would be unrolled, and every sample run through every bounce.
#ifdef LONE
    const int most = 1;
#else
    int most = rest.x > 0.0 ? 4 : 1;
#endif
    for (int bounce = 0; bounce < most; bounce++) {
        vec4 hit = ball(here);
        vec3 normal = (point - hit.xyz) / hit.w;
        kept *= mirror(-dot(way, normal));
        way = reflect(way, normal);
        here = next_ball(point, way, here, 0.0, near);
        if (here == NOBODY) break;
        point += near * way;
    }
    return kept * radiance(way);
}

// Way from a line to a ball's centre.
vec3 aside(vec3 from, vec3 way, vec4 sphere) {
    vec3 offset = sphere.xyz - from;
    return offset - dot(offset, way) * way;
}

// How wide a sample is, straight towards the ball's centre. To be called for all samples alike: it compares neighbours.
float breadth(vec3 from, vec3 way, vec4 sphere) {
    float miss = length(aside(from, way, sphere));
    return length(vec2(dFdx(miss), dFdy(miss)));
}

// Share of a sample that a ball covers: its outline is a ramp one sample wide.
float cover(vec3 from, vec3 way, vec4 sphere) {
    float miss = length(aside(from, way, sphere));
    return clamp((sphere.w - miss) / breadth(from, way, sphere) + 0.5, 0.0, 1.0);
}

// Distance to a ball along a ray that hits it, or passes it so closely that the sample is partly covered.
float touch(vec3 from, vec3 way, vec4 sphere) {
    vec3 offset = from - sphere.xyz;
    float b = dot(offset, way);
    return -b - sqrt(max(b * b - dot(offset, offset) + sphere.w * sphere.w, 0.0));
}

// Shares of a sample in which this ball is in front, and in which there is none.
vec2 shares(vec3 from, vec3 way) {
    float own = cover(from, way, ball(SELF)), open = 1.0 - own, near = touch(from, way, ball(SELF));
#ifndef APART
    for (int k = 0; k < COUNT; k++) {
        float share = k < int(rest.x) ? cover(from, way, ball(k)) : 0.0;
        open *= 1.0 - share;
        if (touch(from, way, ball(k)) < near) own *= 1.0 - share;
    }
#endif
    return vec2(own, open);
}

// What this ball shows in the part of a sample that it covers. At the rim it changes too fast for one ray: there are
// two, by Gauss's rule straight inwards over the cosine of incidence, in which it is smooth.
float face(vec3 from, vec3 way, float wide) {
    vec3 inward = aside(from, way, ball(SELF));
    float miss = length(inward), low = miss - wide / 2.0, high = min(miss + wide / 2.0, 1.0);
    float outer = sqrt(1.0 - high * high), inner = sqrt(max(1.0 - low * low, 1e-9));
    int rays = high > 1.0 - wide ? 2 : 1;
    float total = 0.0, weights = 0.0;
    for (int k = 0;; k++) {  // left at its end: from its head it would be run once more
        float cosine = mix(outer, inner, 0.5 + (float(k) - 0.5) * 0.57735027), radius = sqrt(1.0 - cosine * cosine);
        float weight = rays == 1 ? 1.0 : cosine / radius;
        vec3 at = rays == 1 ? from : from + inward * (1.0 - radius / max(miss, 1e-6));
        total += weight * seen(at, way, touch(at, way, ball(SELF)));
        weights += weight;
        if (k + 1 >= rays) break;
    }
    return total / weights;
}

#if SCENE == 1
// The ball's mirror image in the plate, less the mirrored room it hides.
float image(vec3 from, vec3 way) {
    vec3 back = reflect(way, up), at = from - way * (dot(from, up) + note(0).x) / dot(way, up);
    float hit = entry(at, back, ball(SELF)), far;
    next_ball(at, back, SELF, 0.0, far);
    return hit > 0.0 && hit < NOTHING && !(far < hit) ? gloss * (seen(at, back, hit) - radiance(back)) : 0.0;
}
#endif

#if SCENE == 2
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
    return light * (1.0 - cover(from, way, sphere));
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
#endif

void main() {
    // In this order the first difference is exact, and a ball the same wherever its tile lies.
    vec2 sample_at = (gl_FragCoord.xy - place.xy) - place.zw;
    vec3 from = vec3(lens.xy * sample_at.x + lens.zw * sample_at.y, 0.0);
    vec3 way = normalize(from - eye.xyz);
#ifdef INSIDE
    float value = seen(from, way, touch(from, way, ball(SELF))) - rest.w;
#elif SCENE == 2
    float value = shade(from, way);
#elif SCENE == 3
    float value = lit_plate(from, way);
#else
    vec2 share = shares(from, way);
    float wide = breadth(from, way, ball(SELF));
#if SCENE == 0
    float value = share.x > 0.0 ? share.x * (face(from, way, wide) - rest.w) : 0.0;
#else
    float hidden = gloss * radiance(reflect(way, up));
    float value = share.x > 0.0 ? share.x * (face(from, way, wide) - hidden) : 0.0;
    value += gloss > 0.0 && share.y > 0.0 ? share.y * image(from, way) : 0.0;
#endif
#endif
    picture = vec4(eye.w * value);
}
