// Shader of the points: colour by view, filter by class, clip box of a section.

import * as THREE from "three";

const VERTEX = /* glsl */ `
precision highp float;
precision highp int;
in vec4 position;  // x, y, z in edges of the cube, intensity
in vec4 codes;     // class, confidence, reference, highlighted
in vec4 object;    // bytes of the number
in vec4 rgb;
uniform mat4 modelViewMatrix, projectionMatrix, modelMatrix;
uniform float edge, splat, focal, least;
uniform int view;
uniform sampler2D palette, objects;
uniform vec2 heights, intensities;
uniform float selected;
uniform vec3 clipPlace, clipAlong;
uniform float clipHalf, front;
out vec3 shade;

vec3 ramp(float t) {  // viridis, by a polynomial
  t = clamp(t, 0.0, 1.0);
  const vec3 c0 = vec3(0.2777, 0.0054, 0.3341), c1 = vec3(0.1051, 1.4046, 1.3846), c2 = vec3(-0.3309, 0.2148, 0.0951);
  const vec3 c3 = vec3(-4.6342, -5.7991, -19.3324), c4 = vec3(6.2283, 14.1799, 56.6906), c5 = vec3(4.7764, -13.7451, -65.3530);
  const vec3 c6 = vec3(-5.4355, 4.6459, 26.3124);
  return c0 + t * (c1 + t * (c2 + t * (c3 + t * (c4 + t * (c5 + t * c6)))));
}

void main() {
  vec3 local = position.xyz * edge * (65535.0 / 65536.0);
  vec4 world = modelMatrix * vec4(local, 1.0);
  vec4 seen = modelViewMatrix * vec4(local, 1.0);
  gl_Position = projectionMatrix * seen;
  gl_PointSize = clamp(splat * focal / max(0.05, -seen.z), least, 9.0);
  vec4 known = texture(palette, vec2((codes.x + 0.5) / 256.0, 0.5));
  float number = object.x + 256.0 * object.y + 65536.0 * object.z;
  float height = (world.z - heights.x) / max(0.01, heights.y - heights.x);
  float gray = clamp((position.w * 65535.0 - intensities.x) / max(1.0, intensities.y - intensities.x), 0.0, 1.0);
  shade = known.rgb * (0.7 + 0.3 * gray);  // the intensity shows edges within a class
  if (view == 1) shade = ramp(codes.y / 255.0);
  else if (view == 2) shade = vec3(0.08 + 0.92 * gray);
  else if (view == 3) shade = ramp(height);
  else if (view == 4) shade = rgb.rgb;
  else if (view == 5 || view == 6) {
    ivec2 size = textureSize(objects, 0);
    int row = int(number);
    vec4 marked = row < size.x * size.y ? texelFetch(objects, ivec2(row % size.x, row / size.x), 0) : vec4(0.0);
    shade = number > 0.5 && marked.a > 0.5 ? marked.rgb * (0.75 + 0.25 * gray) : vec3(0.30 + 0.25 * gray);
  } else if (view == 7) {
    shade = codes.z < 1.5 ? vec3(0.35) : codes.z == codes.x ? vec3(0.30, 0.42, 0.55) : vec3(0.95, 0.2, 0.15);
  }
  if (codes.w > 0.5 || selected > 0.5 && number == selected) {
    shade = mix(shade, vec3(1.0, 0.85, 0.1), 0.65);
    gl_PointSize += 1.0;
  }
  bool cut = -seen.z < front || clipHalf > 0.0 && abs(dot(world.xyz - clipPlace, clipAlong)) > clipHalf;
  if (known.a < 0.5 || cut) gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
}
`;

const FRAGMENT = /* glsl */ `
precision highp float;
in vec3 shade;
out vec4 colour;
void main() { colour = vec4(shade, 1.0); }
`;

export function pointMaterial(): THREE.RawShaderMaterial {
  const palette = new THREE.DataTexture(new Uint8Array(256 * 4), 256, 1);
  const objects = new THREE.DataTexture(new Uint8Array(4), 1, 1);
  for (const texture of [palette, objects]) texture.needsUpdate = true;
  return new THREE.RawShaderMaterial({
    glslVersion: THREE.GLSL3,
    vertexShader: VERTEX,
    fragmentShader: FRAGMENT,
    uniforms: {
      edge: { value: 1 },
      splat: { value: 0.05 },
      focal: { value: 1000 },
      least: { value: 1.5 },
      view: { value: 0 },
      palette: { value: palette },
      objects: { value: objects },
      heights: { value: new THREE.Vector2(0, 1) },
      intensities: { value: new THREE.Vector2(0, 1) },
      selected: { value: 0 },
      clipPlace: { value: new THREE.Vector3() },
      clipAlong: { value: new THREE.Vector3(1, 0, 0) },
      clipHalf: { value: 0 },
      front: { value: 0 },
    },
  });
}

/** Texture with a colour per number, 1024 to a row; missing numbers are transparent. */
export function objectTexture(colours: Map<number, [number, number, number]>): THREE.DataTexture {
  const most = Math.max(0, ...colours.keys());
  const rows = Math.floor(most / 1024) + 1;
  const data = new Uint8Array(1024 * rows * 4);
  for (const [number, colour] of colours) data.set([...colour, 255], 4 * number);
  const texture = new THREE.DataTexture(data, 1024, rows);
  texture.needsUpdate = true;
  return texture;
}
