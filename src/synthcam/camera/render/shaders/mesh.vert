#version 330 core
// One quad an instance. The instance matrix is no pose: its columns carry what the fragment shader needs.
// SQUARES draws one square of samples a point instead, with the matrix from a row of a texture.
#ifdef SQUARES
layout(location = 0) in vec4 square;  // column and row of its middle, side, number of the ball
uniform sampler2D jobs;
#else
layout(location = 0) in vec3 corner;
layout(location = INST_M_LOC) in mat4 job;
#endif

uniform vec2 atlas;       // size of the buffer, samples
uniform sampler2D others; // one row an instance: neighbours' centres and radii

flat out vec4 place;      // tile's corner in the buffer, centre in the tile; samples
flat out vec4 lens;       // columns of the map from samples to ball radii, in the plane through the centre
flat out vec4 eye;        // camera from the centre, radii, camera axes; weight
flat out vec4 rest;       // number of neighbours, half extent, row, plate's radiance
#ifndef NEAR
flat out vec4 nearest;    // neighbour
#else
#if NEAR > 0
flat out vec4 near_by[NEAR];  // neighbours
#endif
#endif

void main() {
#ifdef SQUARES
    int row = int(square.w);
    mat4 job;
    for (int k = 0; k < 4; k++) job[k] = texelFetch(jobs, ivec2(k, row), 0);
#endif
    place = job[0];
    lens = job[1];
    eye = job[2];
    rest = job[3];
#ifndef NEAR
    nearest = texelFetch(others, ivec2(0, int(rest.z)), 0);
#else
#if NEAR > 0
    for (int k = 0; k < NEAR; k++) near_by[k] = texelFetch(others, ivec2(k, int(rest.z)), 0);
#endif
#endif
#ifdef SQUARES
    gl_PointSize = square.z;
    gl_Position = vec4(2.0 * square.xy / atlas - 1.0, 0.0, 1.0);
#else
    gl_Position = vec4(2.0 * (place.xy + place.zw + corner.xy * rest.y) / atlas - 1.0, 0.0, 1.0);
#endif
}
