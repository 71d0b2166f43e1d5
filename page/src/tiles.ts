// Chunks of points: decoding, choice by view, loading within a budget.

import * as THREE from "three";

import type { Source } from "./source";
import type { FirstFacts, TileFacts } from "./types";

/** Classes and marks of points that differ from those of the tiles: by row, and by object. */
export interface Colouring {
  painted: Map<number, number>;
  recoded: Map<number, number>;
  highlighted: Set<number>;
}

export class PointNode {
  points: THREE.Points | null = null;
  state: "absent" | "loading" | "loaded" = "absent";
  used = 0;
  steps!: Uint16Array;
  objects!: Uint32Array;
  rows!: Uint32Array;
  codes!: Uint8Array;
  /** Classes of the file, kept once points were painted. */
  original: Uint8Array | null = null;
  /** Number of highlighted points. */
  private marked = 0;

  constructor(
    readonly low: THREE.Vector3,
    readonly edge: number,
    readonly box: THREE.Box3,
    readonly level: number,
    readonly spacing: number,
    readonly first: number,
    readonly count: number,
  ) {}

  /** Local coordinates of a point. */
  place(index: number, target: THREE.Vector3): THREE.Vector3 {
    const step = this.edge / 65536;
    const at = 4 * index;
    return target.set(
      this.low.x + this.steps[at] * step,
      this.low.y + this.steps[at + 1] * step,
      this.low.z + this.steps[at + 2] * step,
    );
  }

  decode(buffer: ArrayBuffer, coloured: boolean, material: THREE.Material): void {
    const n = this.count;
    this.steps = new Uint16Array(buffer, 0, 4 * n);
    this.objects = new Uint32Array(buffer, 8 * n, n);
    this.rows = new Uint32Array(buffer, 12 * n, n);
    this.codes = new Uint8Array(buffer, 16 * n, 4 * n);
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(this.steps, 4, true));
    geometry.setAttribute("object", new THREE.BufferAttribute(new Uint8Array(buffer, 8 * n, 4 * n), 4));
    geometry.setAttribute("codes", new THREE.BufferAttribute(this.codes, 4));
    if (coloured) geometry.setAttribute("rgb", new THREE.BufferAttribute(new Uint8Array(buffer, 20 * n, 4 * n), 4, true));
    geometry.boundingSphere = this.box.getBoundingSphere(new THREE.Sphere());
    this.points = new THREE.Points(geometry, material);
    this.points.position.copy(this.low);
    this.points.frustumCulled = false; // nodes outside of the view are not chosen
    this.points.matrixAutoUpdate = false;
    this.points.updateMatrix();
    this.points.updateMatrixWorld(true);
    const { edge } = this;
    this.points.onBeforeRender = (_renderer, _scene, _camera, _geometry, used) => {
      const shader = used as THREE.RawShaderMaterial;
      shader.uniforms.edge.value = edge;
      shader.uniformsNeedUpdate = true;
    };
    this.state = "loaded";
  }

  /** Show painted points and those of changed objects in their new class, and mark highlighted ones. */
  repaint({ painted, recoded, highlighted }: Colouring): boolean {
    if (this.state !== "loaded") return false;
    let changed = this.highlight(highlighted);
    if (painted.size || recoded.size || this.original) changed = this.recode(painted, recoded) || changed;
    if (changed) (this.points!.geometry.getAttribute("codes") as THREE.BufferAttribute).needsUpdate = true;
    return changed;
  }

  private highlight(rows: Set<number>): boolean {
    if (!rows.size && !this.marked) return false;
    this.marked = 0;
    for (let i = 0; i < this.count; i++) {
      const mark = rows.size && rows.has(this.rows[i]) ? 1 : 0;
      this.codes[4 * i + 3] = mark;
      this.marked += mark;
    }
    return true;
  }

  private recode(painted: Map<number, number>, recoded: Map<number, number>): boolean {
    let changed = false;
    for (let i = 0; i < this.count; i++) {
      const wanted = painted.get(this.rows[i]) ?? (this.objects[i] ? recoded.get(this.objects[i]) : undefined);
      const before = this.original ? this.original[i] : this.codes[4 * i];
      const code = wanted ?? before;
      if (this.codes[4 * i] === code) continue;
      if (!this.original) {
        this.original = new Uint8Array(this.count);
        for (let k = 0; k < this.count; k++) this.original[k] = this.codes[4 * k];
      }
      this.codes[4 * i] = code;
      changed = true;
    }
    return changed;
  }

  dispose(): void {
    this.points?.geometry.dispose();
    this.points?.removeFromParent();
    this.points = null;
    this.original = null;
    this.marked = 0;
    this.state = "absent";
  }
}

export function firstNode(facts: FirstFacts): PointNode {
  const low = new THREE.Vector3(...facts.low);
  const box = new THREE.Box3(low.clone(), low.clone().addScalar(facts.edge));
  return new PointNode(low, facts.edge, box, -1, 0, 0, facts.n_points);
}

function nodesOf(facts: TileFacts): PointNode[] {
  return facts.nodes.map(([level, x, y, z, first, count]) => {
    const depth = Math.max(0, level - facts.undivided);
    const width = facts.edge / 2 ** depth;
    const corner = new THREE.Vector3(x * width, y * width, z * width);
    const box = new THREE.Box3(corner, corner.clone().addScalar(width));
    const cube = new THREE.Vector3(x >> depth, y >> depth, z >> depth).multiplyScalar(facts.edge);
    return new PointNode(cube, facts.edge, box, level, facts.edge / 2 ** (facts.coarsest + level), first, count);
  });
}

interface Slab {
  place: [number, number, number];
  heading: number;
  thickness: number;
}

function touches(slab: Slab, box: THREE.Box3): boolean {
  const [a, b] = [Math.sin(slab.heading), Math.cos(slab.heading)];
  const middle = ((box.min.x + box.max.x) / 2 - slab.place[0]) * a + ((box.min.y + box.max.y) / 2 - slab.place[1]) * b;
  const reach = ((box.max.x - box.min.x) / 2) * Math.abs(a) + ((box.max.y - box.min.y) / 2) * Math.abs(b);
  return Math.abs(middle) <= reach + slab.thickness / 2;
}

interface Chosen {
  node: PointNode;
  size: number;
}

const LARGEST_REQUEST = 4e6;
const LARGEST_GAP = 1e5;
const REQUESTS = 4;

/** All points of the coarse levels, as x, y, z and class, for the map. */
export async function coarsePoints(source: Source, facts: TileFacts, most = 400_000): Promise<{ places: Float32Array; codes: Uint8Array }> {
  const bytes = facts.coloured ? 24 : 20;
  const nodes = nodesOf(facts);
  const levels: PointNode[][] = [];
  let total = 0;
  for (let level = 0; level < 4; level++) {
    const own = nodes.filter((node) => node.level === level);
    const n = own.reduce((sum, node) => sum + node.count, 0);
    if (level > 0 && total + n > most) break;
    total += n;
    levels.push(own);
  }
  const places = new Float32Array(3 * total);
  const codes = new Uint8Array(total);
  const place = new THREE.Vector3();
  let at = 0;
  for (const [level, own] of levels.entries()) {
    const n = own.reduce((sum, node) => sum + node.count, 0);
    if (!n) continue;
    const data = await source.chunk(level, 0, n * bytes);
    for (const node of own) {
      const begin = node.first * bytes;
      node.steps = new Uint16Array(data.slice(begin, begin + 8 * node.count));
      const classes = new Uint8Array(data, begin + 16 * node.count, 4 * node.count);
      for (let i = 0; i < node.count; i++, at++) {
        node.place(i, place).toArray(places, 3 * at);
        codes[at] = classes[4 * i];
      }
    }
  }
  return { places, codes };
}

export class Tiles {
  readonly nodes: PointNode[];
  private readonly bytes: number;
  private running = 0;
  private pending: PointNode[] = [];
  private clock = 0;
  failed = "";

  constructor(
    private readonly source: Source,
    private readonly facts: TileFacts,
    private readonly group: THREE.Group,
    private readonly material: THREE.Material,
    private readonly loaded: (node: PointNode) => void,
  ) {
    this.nodes = nodesOf(facts);
    this.bytes = facts.coloured ? 24 : 20;
  }

  get busy(): boolean {
    return this.running > 0 || this.pending.length > 0;
  }

  /** Show the nodes that a view needs, coarse ones first, up to a number of points; returns the number shown. */
  show(camera: THREE.PerspectiveCamera, focal: number, budget: number, load: boolean, detail: number, section: Slab | null): number {
    const frustum = new THREE.Frustum().setFromProjectionMatrix(
      new THREE.Matrix4().multiplyMatrices(camera.projectionMatrix, camera.matrixWorldInverse),
    );
    const eye = camera.position;
    const wanted: Chosen[] = [];
    for (const node of this.nodes) {
      if (!frustum.intersectsBox(node.box) || (section && !touches(section, node.box))) continue;
      const distance = Math.max(0.5, node.box.distanceToPoint(eye));
      const size = (2 * node.spacing * focal) / distance; // of the level above, pixels
      if (node.level === 0 || size > detail) wanted.push({ node, size });
    }
    wanted.sort((a, b) => b.size - a.size);
    this.clock += 1;
    let shown = 0;
    let planned = 0;
    const missing: PointNode[] = [];
    const visible = new Set<PointNode>();
    for (const { node } of wanted) {
      planned += node.count;
      if (planned > budget && planned > node.count) break; // at least one node
      node.used = this.clock;
      if (node.state === "loaded") {
        visible.add(node);
        shown += node.count;
      } else if (node.state === "absent") missing.push(node);
    }
    for (const node of this.nodes) {
      if (node.points && node.points.visible !== visible.has(node)) node.points.visible = visible.has(node);
    }
    if (load) {
      this.forget(3 * budget + 1e6);
      this.pending = missing;
      this.pump();
    }
    return shown;
  }

  private forget(most: number): void {
    let total = 0;
    const kept = this.nodes.filter((node) => node.state === "loaded");
    for (const node of kept) total += node.count;
    if (total <= most) return;
    kept.sort((a, b) => a.used - b.used);
    for (const node of kept) {
      if (total <= most || node.used === this.clock) break;
      total -= node.count;
      node.dispose();
    }
  }

  /** Start requests for the pending nodes; each one that ends starts the next. */
  private pump(): void {
    while (this.pending.length && this.running < REQUESTS) {
      const first = this.pending[0];
      // Chunks that lie close together in the file of a level come with one request.
      const run = [first];
      const following = this.pending
        .filter((node) => node.level === first.level && node.first > first.first)
        .sort((a, b) => a.first - b.first);
      let end = first.first + first.count;
      for (const node of following) {
        if ((node.first - end) * this.bytes > LARGEST_GAP) break;
        if ((node.first + node.count - first.first) * this.bytes > LARGEST_REQUEST) break;
        run.push(node);
        end = node.first + node.count;
      }
      const taken = new Set(run);
      this.pending = this.pending.filter((node) => !taken.has(node));
      void this.request(first.level, run);
    }
  }

  private async request(level: number, run: PointNode[]): Promise<void> {
    this.running += 1;
    for (const node of run) node.state = "loading";
    const last = run[run.length - 1];
    const begin = run[0].first * this.bytes;
    try {
      const data = await this.source.chunk(level, begin, (last.first + last.count) * this.bytes);
      for (const node of run) {
        const at = node.first * this.bytes - begin;
        node.decode(data.slice(at, at + node.count * this.bytes), this.facts.coloured, this.material);
        this.group.add(node.points!);
        node.points!.visible = false; // until the next frame chooses it
        this.loaded(node);
      }
      this.failed = "";
    } catch (error) {
      this.failed = String(error instanceof Error ? error.message : error);
      for (const node of run) node.state = "absent";
    } finally {
      this.running -= 1;
      if (!this.failed) this.pump();
    }
  }
}
