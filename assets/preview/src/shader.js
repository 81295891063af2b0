// One material for all views, so that changing the view changes a number.
//
// Light as luxel computes it: a Lambertian surface of albedo ρ under irradiance E shows ρE/π + Lₑ (cd/m²), with
// ρ = base colour × (1 − metallic + metallic × roughness × metal_diffuse). Tone mapping is that of luxel's own picture
// (Reinhard et al. 2002, eq. 4, applied to the brightest band).

import { DoubleSide, FrontSide, Matrix3, ShaderMaterial, Vector2, Vector3 } from 'three';

// Their numbers in the shader are their places here.
export const VIEWS = ['lit', 'lightmap', 'albedo', 'density', 'charts', 'invalid'];

// Uniforms that all materials share.
export const common = {
  view: { value: 0 },
  exposure: { value: 1 },
  white: { value: 4 },
  metalDiffuse: { value: 0.5 },
  emissiveScale: { value: 1 },
  // What stands in for light where an object has no lightmap [lux].
  meanIrradiance: { value: 0 },
  // Texels per unit of length that objects have as a rule.
  usualDensity: { value: 1 },
};

const VERTEX = /* glsl */ `
#include <common>
#include <batching_pars_vertex>
#include <morphtarget_pars_vertex>
#include <skinning_pars_vertex>
#ifdef USE_CORNER_COLOR
attribute vec4 color;
#endif
#ifdef LIGHTMAP_SET
attribute float chart;
varying float vChart;
varying vec2 vLightmap;
#endif
uniform mat3 baseMatrix, emissiveMatrix, metalMatrix;
varying vec2 vBase, vEmissive, vMetal;
varying vec3 vToEye, vNormalView;
varying vec4 vColor;
void main() {
  #include <beginnormal_vertex>
  #include <morphinstance_vertex>
  #include <morphnormal_vertex>
  #include <skinbase_vertex>
  #include <skinnormal_vertex>
  #include <defaultnormal_vertex>
  vNormalView = transformedNormal;
  #include <begin_vertex>
  #include <morphtarget_vertex>
  #include <skinning_vertex>
  #include <project_vertex>
  vToEye = -mvPosition.xyz;
  vColor = vec4(1.0);
  #ifdef USE_CORNER_COLOR
  vColor = color;
  #endif
  #ifdef LIGHTMAP_SET
  vLightmap = LIGHTMAP_SET;
  vChart = chart;
  #endif
  vBase = vEmissive = vMetal = vec2(0.0);
  #ifdef BASE_SET
  vBase = (baseMatrix * vec3(BASE_SET, 1.0)).xy;
  #endif
  #ifdef EMISSIVE_SET
  vEmissive = (emissiveMatrix * vec3(EMISSIVE_SET, 1.0)).xy;
  #endif
  #ifdef METAL_SET
  vMetal = (metalMatrix * vec3(METAL_SET, 1.0)).xy;
  #endif
}`;

const FRAGMENT = /* glsl */ `
#include <common>
uniform int view;
uniform float exposure, white, metalDiffuse, emissiveScale, meanIrradiance, usualDensity;
uniform vec3 base, emissive;
uniform float opacity, alphaCut, metallic, roughness, lightmapScale;
uniform vec2 lightmapSize;
uniform sampler2D baseMap, emissiveMap, metalMap, lightmap, texels;
varying vec2 vBase, vEmissive, vMetal;
varying vec3 vToEye, vNormalView;
varying vec4 vColor;
#ifdef LIGHTMAP_SET
varying float vChart;
varying vec2 vLightmap;
#endif

vec3 toned(vec3 radiance) {
  vec3 exposed = max(radiance, 0.0) * exposure;
  float most = max(exposed.r, max(exposed.g, exposed.b));
  if (most <= 0.0) return vec3(0.0);
  float shown = most >= white ? 1.0 : most * (1.0 + most / (white * white)) / (1.0 + most);
  return clamp(exposed * (shown / most), 0.0, 1.0);
}

// A little shape for views without light, from the eye's side.
float shape() {
  vec3 normal = dot(vNormalView, vNormalView) > 0.0 ? normalize(vNormalView) : cross(dFdx(vToEye), dFdy(vToEye));
  return 0.6 + 0.4 * abs(dot(normalize(normal), normalize(vToEye)));
}

// Diagonal stripes: nothing is known here.
vec3 unknown() {
  float stripe = step(0.5, fract((gl_FragCoord.x + gl_FragCoord.y) / 12.0));
  return mix(vec3(0.10), vec3(0.16), stripe);
}

vec3 hue(float turn) {
  return clamp(abs(fract(turn + vec3(0.0, 2.0 / 3.0, 1.0 / 3.0)) * 6.0 - 3.0) - 1.0, 0.0, 1.0);
}

#ifdef LIGHTMAP_SET
// Texels along a unit of length, from the areas that a pixel covers in both.
float density() {
  vec2 texel = vLightmap * lightmapSize;
  vec2 tx = dFdx(texel), ty = dFdy(texel);
  float area = length(cross(dFdx(vToEye), dFdy(vToEye)));
  return sqrt(abs(tx.x * ty.y - tx.y * ty.x) / max(area, 1e-30));
}

vec3 densityColor() {
  // Blue: a quarter of the usual density or less; white: as usual; red: four times or more.
  float octaves = clamp(0.5 * log2(max(density(), 1e-30) / usualDensity), -1.0, 1.0);
  vec3 far = octaves < 0.0 ? vec3(0.05, 0.22, 0.9) : vec3(0.9, 0.1, 0.05);
  vec3 tint = mix(vec3(0.75), far, abs(octaves));
  // Checks of eight texels, grey where they are smaller than two pixels.
  vec2 cell = vLightmap * lightmapSize / 8.0;
  float checks = mod(floor(cell.x) + floor(cell.y), 2.0);
  float coarse = max(length(dFdx(cell)), length(dFdy(cell)));
  return tint * mix(mix(0.45, 1.0, checks), 0.725, smoothstep(0.3, 0.7, coarse));
}

vec3 chartColor() {
  float number = floor(vChart + 0.5);
  vec3 color = hue(fract(number * 0.61803399));
  return mix(color, vec3(0.85), 0.25 + 0.2 * mod(number, 3.0)) * shape();
}

vec3 invalidColor(vec3 plain) {
  ivec2 at = ivec2(clamp(vLightmap * lightmapSize, vec2(0.0), lightmapSize - 1.0));
  float cover = texelFetch(texels, at, 0).a;
  if (cover < 0.0) return vec3(0.85, 0.06, 0.04);
  if (cover == 0.0) return vec3(0.55, 0.03, 0.55);
  if (cover < 0.5) return vec3(0.9, 0.5, 0.03);
  return plain;
}
#endif

void main() {
  vec4 color = vec4(base, opacity) * vColor;
  #ifdef BASE_SET
  color *= texture2D(baseMap, vBase);
  #endif
  #ifdef IS_OPAQUE
  color.a = 1.0;
  #endif
  if (color.a < alphaCut) discard;
  #ifdef IS_MASK
  color.a = 1.0;
  #endif
  float m = metallic, r = roughness;
  #ifdef METAL_SET
  vec4 metal = texture2D(metalMap, vMetal);
  m *= metal.b;
  r *= metal.g;
  #endif
  vec3 albedo = color.rgb * (1.0 - m + m * r * metalDiffuse);
  vec3 emitted = emissive * emissiveScale;
  #ifdef EMISSIVE_SET
  emitted *= texture2D(emissiveMap, vEmissive).rgb;
  #endif
  #ifdef LIGHTMAP_SET
  vec3 irradiance = texture2D(lightmap, vLightmap).rgb * lightmapScale;
  #else
  vec3 irradiance = vec3(meanIrradiance);
  #endif

  vec3 shown;
  #ifdef IS_UNLIT
  // It has no light of its own in cd/m²: its colour is what there is to show.
  if (view == 0 || view == 2) shown = color.rgb; else shown = unknown();
  #else
  if (view == 0) shown = toned(albedo * irradiance / PI + emitted);
  else if (view == 2) shown = albedo;
  #ifdef LIGHTMAP_SET
  else if (view == 1) shown = toned(irradiance / PI);
  else if (view == 3) shown = densityColor();
  else if (view == 4) shown = chartColor();
  else shown = invalidColor(vec3(0.5) * toned(vec3(dot(irradiance, vec3(0.2126, 0.7152, 0.0722)) / PI)) + 0.02);
  #else
  else shown = unknown();
  #endif
  #endif
  // Albedo of glass is seen through; a diagnosis is not.
  gl_FragColor = vec4(shown, view == 0 || view == 2 ? color.a : 1.0);
  #include <colorspace_fragment>
}`;

const SETS = ['uv', 'uv1', 'uv2', 'uv3'];

// The material that shows an object of a loaded level. `source` is what GLTFLoader made of the glTF material.
export function viewMaterial(source, geometry) {
  const lightmap = source.userData.lightmap;
  const has = (name) => geometry.hasAttribute(name);
  const defines = {};
  const texture = (name, map) => {
    const set = SETS[map?.channel ?? 0];
    if (!map || !has(set)) return { value: null };
    defines[`${name}_SET`] = set;
    for (const needed of ['uv1', 'uv2', 'uv3']) if (set === needed) defines[`USE_${needed.toUpperCase()}`] = '';
    return { value: map };
  };
  const matrix = (map) => {
    map?.updateMatrix();
    return { value: map?.matrix ?? new Matrix3() };
  };
  const isUnlit = source.isMeshBasicMaterial === true;
  // Light passes glass and meets its surface by what is left.
  const opacity = source.opacity * (1 - (source.transmission ?? 0));
  const isClear = source.transparent || opacity < 1;
  const uniforms = {
    ...common,
    base: { value: new Vector3().setFromColor(source.color) },
    emissive: { value: new Vector3() },
    opacity: { value: opacity },
    alphaCut: { value: source.alphaTest },
    metallic: { value: isUnlit ? 0 : source.metalness },
    roughness: { value: isUnlit ? 1 : source.roughness },
    baseMap: texture('BASE', source.map),
    emissiveMap: texture('EMISSIVE', source.emissiveMap),
    metalMap: texture('METAL', source.metalnessMap),
    baseMatrix: matrix(source.map),
    emissiveMatrix: matrix(source.emissiveMap),
    metalMatrix: matrix(source.metalnessMap),
    lightmap: { value: null },
    texels: { value: null },
    lightmapScale: { value: 1 },
    lightmapSize: { value: new Vector2(1, 1) },
  };
  if (source.emissive) uniforms.emissive.value.setFromColor(source.emissive).multiplyScalar(source.emissiveIntensity);
  const set = SETS[lightmap?.channel];
  if (lightmap && has(set) && has('chart') && !isUnlit) {
    defines.LIGHTMAP_SET = set;
    if (set !== 'uv') defines[`USE_${set.toUpperCase()}`] = '';
  }
  if (has('color') && source.vertexColors) defines.USE_CORNER_COLOR = '';
  if (isUnlit) defines.IS_UNLIT = '';
  if (!isClear) defines[source.alphaTest > 0 ? 'IS_MASK' : 'IS_OPAQUE'] = '';
  return new ShaderMaterial({
    name: source.name,
    vertexShader: VERTEX,
    fragmentShader: FRAGMENT,
    defines,
    uniforms,
    side: source.side === DoubleSide ? DoubleSide : FrontSide,
    transparent: isClear,
    depthWrite: !isClear,
  });
}
