// The point cloud in three dimensions: camera, frames, points that are clicked.

import * as THREE from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";

import { channels, classColour, kindColour, STATUS_COLOURS } from "./colours";
import { Marks } from "./marks";
import { objectTexture, pointMaterial } from "./material";
import { type Model, type PickedPoint, type Place, VIEWS } from "./model";
import { firstNode, type PointNode, Tiles } from "./tiles";

const IDLE = 140; // milliseconds without a movement until the picture is refined
const FIELD = 50;

THREE.Object3D.DEFAULT_UP.set(0, 0, 1);

export class Cloud {
  readonly canvas: HTMLCanvasElement;
  readonly software: boolean;
  readonly camera = new THREE.PerspectiveCamera(FIELD, 1, 0.1, 5000);
  readonly controls: OrbitControls;
  readonly marks: Marks;
  private readonly renderer: THREE.WebGLRenderer;
  private readonly scene = new THREE.Scene();
  private readonly group = new THREE.Group();
  private readonly material = pointMaterial();
  private first: PointNode | null = null;
  private tiles: Tiles | null = null;
  private tiled = false;
  private waiting = false;
  private measuring = false;
  private missed = false;
  private awaited: (() => void)[] = [];
  private moved = 0;
  private refine = 0;
  private budgets: { still: number; moving: number };
  private readonly bounds: THREE.Box3;
  shown = 0;
  frame = 0;
  frames = 0;
  detail = 1.6;
  /** Points nearer than this share of the way to the focus are hidden; the focus ends when the target leaves it. */
  private focused: { place: THREE.Vector3; radius: number } | null = null;
  onFrame: () => void = () => {};

  constructor(
    readonly host: HTMLElement,
    private readonly model: Model,
  ) {
    this.renderer = new THREE.WebGLRenderer({ antialias: false, powerPreference: "high-performance" });
    this.canvas = this.renderer.domElement;
    this.canvas.tabIndex = 0;
    this.canvas.setAttribute("aria-label", "Point cloud. Arrow keys move, plus and minus zoom, the question mark lists all keys.");
    host.append(this.canvas);
    this.software = /swiftshader|llvmpipe|software|basic render/i.test(rendererName(this.renderer.getContext()));
    this.budgets = this.software ? { still: 700_000, moving: 150_000 } : { still: 4_000_000, moving: 1_500_000 };
    const [low, high] = model.survey.first.bounds;
    this.bounds = new THREE.Box3(new THREE.Vector3(...low), new THREE.Vector3(...high));
    this.marks = new Marks(model);
    this.scene.add(this.group, this.marks.group);
    this.controls = new OrbitControls(this.camera, this.canvas);
    this.controls.zoomToCursor = true;
    this.controls.screenSpacePanning = false;
    this.controls.maxPolarAngle = Math.PI * 0.98;
    this.controls.minDistance = 0.3;
    this.controls.addEventListener("change", () => this.movedNow());
    const uniforms = this.material.uniforms;
    uniforms.heights.value.set(...model.survey.first.height);
    uniforms.intensities.value.set(...model.survey.first.intensity);
    new ResizeObserver(() => this.resize()).observe(host);
    model.on(["view", "filter", "decisions", "selection", "theme", "marked"], () => this.recolour());
    model.on(["paint"], () => this.repaint());
    this.resize();
    this.recolour();
    this.showAll();
  }

  setFirst(data: ArrayBuffer): void {
    this.first = firstNode(this.model.survey.first);
    this.first.decode(data, this.model.survey.first.coloured, this.material);
    this.first.repaint(this.model);
    this.group.add(this.first.points!);
    this.draw();
  }

  setTiles(tiles: ConstructorParameters<typeof Tiles>[1]): void {
    this.tiles = new Tiles(this.model.source, tiles, this.group, this.material, (node) => {
      node.repaint(this.model);
      this.draw();
    });
    this.draw();
  }

  get loading(): boolean {
    return this.tiles?.busy ?? false;
  }

  get failed(): string {
    return this.tiles?.failed ?? "";
  }

  /** Wait until a frame with points is on the screen. */
  drawn(): Promise<void> {
    return new Promise((done) => {
      this.awaited.push(done);
      this.draw();
    });
  }

  private *chosen(): Generator<PointNode> {
    if (this.first?.points?.visible) yield this.first;
    for (const node of this.tiles?.nodes ?? []) if (node.points?.visible) yield node;
  }

  private repaint(): void {
    this.first?.repaint(this.model);
    for (const node of this.tiles?.nodes ?? []) node.repaint(this.model);
    this.draw();
  }

  private recolour(): void {
    const { model, material } = this;
    const palette = material.uniforms.palette.value as THREE.DataTexture;
    const data = palette.image.data as Uint8Array;
    for (let code = 0; code < 256; code++) {
      data.set([...channels(classColour(code)), model.hiddenClasses.has(code) ? 0 : 255], 4 * code);
    }
    palette.needsUpdate = true;
    const colours = new Map<number, [number, number, number]>();
    for (const object of model.objects) {
      if (!model.shown(object)) continue;
      const colour = model.view === "status" ? STATUS_COLOURS[model.status(object.id)] : kindColour(object.kind, model.kinds);
      colours.set(object.id, channels(colour ?? "#ffffff"));
    }
    for (const [id, { merged_into: owner }] of Object.entries(model.states)) {
      const colour = owner === undefined ? undefined : colours.get(owner);
      if (colour) colours.set(Number(id), colour);
    }
    material.uniforms.objects.value.dispose();
    material.uniforms.objects.value = objectTexture(colours);
    material.uniforms.view.value = VIEWS.indexOf(model.view);
    material.uniforms.selected.value = model.byId.get(model.selected ?? 0)?.made ? 0 : (model.selected ?? 0);
    this.scene.background = new THREE.Color(getComputedStyle(document.body).getPropertyValue("--cloud").trim() || "#10141b");
    this.marks.update();
    this.draw();
  }

  setSection(): void {
    const { section } = this.model;
    const { clipHalf, clipPlace, clipAlong } = this.material.uniforms;
    clipHalf.value = section ? section.thickness / 2 : 0;
    if (section) {
      clipPlace.value.set(...section.place);
      clipAlong.value.set(Math.sin(section.heading), Math.cos(section.heading), 0);
    }
    this.marks.update();
    this.draw();
  }

  resize(): void {
    const { clientWidth: width, clientHeight: height } = this.host;
    if (!width || !height) return;
    this.renderer.setPixelRatio(this.software ? 1 : Math.min(2, devicePixelRatio));
    this.renderer.setSize(width, height);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.draw();
  }

  private movedNow(): void {
    this.moved = performance.now();
    window.clearTimeout(this.refine);
    this.refine = window.setTimeout(() => this.draw(), IDLE + 20);
    this.draw();
  }

  set splat(metres: number) {
    this.material.uniforms.splat.value = metres;
    this.draw();
  }

  /** Ask for a frame. */
  draw(): void {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => {
      this.waiting = false;
      this.render();
    });
  }

  get focal(): number {
    return this.renderer.domElement.height / 2 / Math.tan((this.camera.fov * Math.PI) / 360);
  }

  private render(): void {
    const moving = performance.now() - this.moved < IDLE;
    const budget = moving ? this.budgets.moving : this.budgets.still;
    const distance = this.camera.position.distanceTo(this.controls.target);
    this.camera.near = Math.max(0.05, distance / 300);
    this.camera.far = distance + 2 * this.bounds.getSize(new THREE.Vector3()).length() + 100;
    this.camera.updateProjectionMatrix();
    this.camera.updateMatrixWorld();
    this.material.uniforms.focal.value = this.focal;
    this.material.uniforms.least.value = 1.5 * this.renderer.getPixelRatio();
    if (this.focused && this.focused.place.distanceTo(this.controls.target) > this.focused.radius) this.focused = null;
    this.material.uniforms.front.value = this.front;
    const begin = performance.now();
    const tiled = this.tiles?.show(this.camera, this.focal, budget, !moving, this.detail * this.renderer.getPixelRatio(), this.model.section) ?? 0;
    if (this.first?.points) {
      // The sample of the first picture stays until all tiles of a view are there.
      if (this.tiles && !moving && !this.tiles.busy) this.tiled = true;
      const n = this.tiled ? 0 : Math.max(0, Math.min(budget - tiled, this.first.count));
      this.first.points.visible = n > 0;
      this.first.points.geometry.setDrawRange(0, n);
      this.shown = tiled + n;
    } else this.shown = tiled;
    this.marks.place(this.camera, this.renderer.domElement.height);
    this.renderer.render(this.scene, this.camera);
    this.measure(begin, moving);
    this.frames += 1;
    this.onFrame();
  }

  /** Measure the time until the picture is drawn, and fit the budget to it. */
  private measure(begin: number, moving: boolean): void {
    const gl = this.renderer.getContext() as WebGL2RenderingContext;
    if (this.measuring) {
      this.missed = true;
      return;
    }
    const points = Boolean(this.first?.points);
    const fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    if (!fence) return;
    this.measuring = true;
    gl.flush();
    const check = () => {
      if (gl.getSyncParameter(fence, gl.SYNC_STATUS) !== gl.SIGNALED && performance.now() - begin < 5000) {
        window.setTimeout(check, 4);
        return;
      }
      gl.deleteSync(fence);
      this.measuring = false;
      this.frame = performance.now() - begin;
      this.adapt(moving);
      if (points) for (const done of this.awaited.splice(0)) done();
      else if (this.missed) this.draw();
      this.missed = false;
    };
    window.setTimeout(check, 4);
  }

  /** Fit the number of points to the time of a frame. */
  private adapt(moving: boolean): void {
    const [name, slow, fast, most] = moving ? (["moving", 120, 40, 3e6] as const) : (["still", 600, 150, 6e6] as const);
    if (this.shown > 0.7 * this.budgets[name]) {
      if (this.frame > slow) this.budgets[name] = Math.max(50_000, this.budgets[name] * 0.7);
      else if (this.frame < fast && !this.software) this.budgets[name] = Math.min(most, this.budgets[name] * 1.3);
    }
  }

  // Camera

  get target(): Place {
    return this.controls.target.toArray() as Place;
  }

  /** Heading of the view, clockwise from north, radians. */
  get heading(): number {
    const way = this.controls.target.clone().sub(this.camera.position);
    if (Math.hypot(way.x, way.y) > 1e-3) return Math.atan2(way.x, way.y);
    const up = new THREE.Vector3(0, 1, 0).applyQuaternion(this.camera.quaternion);
    return Math.atan2(up.x, up.y);
  }

  get distance(): number {
    return this.camera.position.distanceTo(this.controls.target);
  }

  /** Look at a place from a distance, a heading and an angle above the ground (radians). */
  look(place: Place, distance: number, heading = this.heading, rise = this.rise, field = FIELD): void {
    const way = new THREE.Vector3(Math.sin(heading) * Math.cos(rise), Math.cos(heading) * Math.cos(rise), -Math.sin(rise));
    this.camera.fov = field;
    this.controls.target.set(...place);
    this.camera.position.copy(this.controls.target).addScaledVector(way, -distance);
    this.camera.updateProjectionMatrix();
    this.controls.update();
    this.movedNow();
  }

  get rise(): number {
    const way = this.controls.target.clone().sub(this.camera.position).normalize();
    return Math.asin(Math.min(1, Math.max(-1, -way.z)));
  }

  showAll(): void {
    const [low, high] = this.model.area().map((corner) => new THREE.Vector3(...corner));
    const size = high.clone().sub(low);
    const centre = low.clone().add(high).multiplyScalar(0.5);
    // The longer side lies across the picture.
    const heading = size.x > size.y ? 0.25 : Math.PI / 2 + 0.25;
    const wide = Math.max(size.x, size.y);
    const deep = Math.min(size.x, size.y);
    const tangent = Math.tan((FIELD * Math.PI) / 360);
    const distance = Math.max((wide * 0.52) / (tangent * this.camera.aspect), (deep * 0.6) / tangent, 10);
    this.look([centre.x, centre.y, this.model.survey.first.height[0]], distance, heading, 0.6);
  }

  fromAbove(): void {
    this.look(this.target, this.distance, 0, Math.PI / 2 - 1e-3);
  }

  focus(id: number): void {
    const object = this.model.byId.get(id);
    if (!object) return;
    const [x, y, z] = object.place;
    const size = Math.max(object.height, Number(object.cells.length ?? 0), Number(object.cells.crown_diameter ?? 0), 2);
    const middle: Place = [x, y, z + object.height / 2];
    this.look(middle, Math.max(6, 2.3 * size), this.clearHeading([x, y, z]), 0.3);
    this.focused = { place: new THREE.Vector3(...middle), radius: 0.75 * size + 1.5 };
  }

  focusGroup(place: Place): void {
    this.look(place, 16, this.clearHeading(place), 0.35);
    this.focused = { place: new THREE.Vector3(...place), radius: 5 };
  }

  /** Distance from the camera in front of which nothing is drawn, so that the focus is seen. */
  private get front(): number {
    return this.focused && this.cutaway && !this.model.section ? Math.max(0, this.distance - this.focused.radius) : 0;
  }

  get hiding(): boolean {
    return this.front > 1;
  }

  cutaway = true;

  /** Heading to look at a place from the path, from which it was seen; without one, from the middle line of the survey. */
  private clearHeading(place: Place): number {
    const { path, origin } = this.model.survey;
    if (!path.length) {
      const [low, high] = this.model.area();
      const across = high[0] - low[0] > high[1] - low[1] ? 1 : 0;
      const side = place[across] - (low[across] + high[across]) / 2;
      if (Math.abs(side) < 1) return this.heading;
      return across === 1 ? (side > 0 ? 0 : Math.PI) : Math.sign(side) * (Math.PI / 2);
    }
    let best = Infinity;
    let heading = this.heading;
    for (const [x, y] of path) {
      const [dx, dy] = [place[0] - (x - origin[0]), place[1] - (y - origin[1])];
      const distance = Math.hypot(dx, dy);
      if (distance < best) [best, heading] = [distance, Math.atan2(dx, dy)];
    }
    return heading;
  }

  /** Move the target along the view: right, forward, in shares of the distance. */
  step(right: number, forward: number): void {
    const { heading } = this;
    const shift = new THREE.Vector3(
      right * Math.cos(heading) + forward * Math.sin(heading),
      forward * Math.cos(heading) - right * Math.sin(heading),
      0,
    ).multiplyScalar(this.distance * (this.camera.fov / FIELD));
    this.controls.target.add(shift);
    this.camera.position.add(shift);
    this.controls.update();
    this.movedNow();
  }

  turn(angle: number): void {
    this.look(this.target, this.distance, this.heading + angle, this.rise, this.camera.fov);
  }

  zoom(factor: number): void {
    this.look(this.target, this.distance * factor, this.heading, this.rise, this.camera.fov);
  }

  moveTo(x: number, y: number): void {
    const shift = new THREE.Vector3(x - this.controls.target.x, y - this.controls.target.y, 0);
    this.controls.target.add(shift);
    this.camera.position.add(shift);
    this.controls.update();
    this.movedNow();
  }

  // Picking

  private ray(x: number, y: number): THREE.Ray {
    const box = this.canvas.getBoundingClientRect();
    const pointer = new THREE.Vector2(((x - box.x) / box.width) * 2 - 1, 1 - ((y - box.y) / box.height) * 2);
    const caster = new THREE.Raycaster();
    caster.setFromCamera(pointer, this.camera);
    return caster.ray;
  }

  /** Mark of an object near a place of the window. */
  pickMark(x: number, y: number): number | null {
    const box = this.canvas.getBoundingClientRect();
    return this.marks.near(this.camera, x - box.x, y - box.y, box.width, box.height);
  }

  /** Point under a place of the window: the front one within some pixels. */
  pick(x: number, y: number, pixels = 5): PickedPoint | null {
    const ray = this.ray(x, y);
    const { origin: o, direction: d } = ray;
    const angle = (pixels * this.renderer.getPixelRatio()) / this.focal;
    const { section, hiddenClasses } = this.model;
    const { front } = this;
    const ahead = this.camera.getWorldDirection(new THREE.Vector3());
    const along = section ? [Math.sin(section.heading), Math.cos(section.heading)] : [0, 0];
    const grown = new THREE.Box3();
    const place = new THREE.Vector3();
    let best = Infinity;
    let found: { node: PointNode; index: number } | null = null;
    for (const node of this.chosen()) {
      const reach = angle * node.box.distanceToPoint(o) + angle * node.edge;
      if (!ray.intersectsBox(grown.copy(node.box).expandByScalar(reach))) continue;
      const step = node.edge / 65536;
      const { x: lx, y: ly, z: lz } = node.low;
      const n = Math.min(node.count, node.points!.geometry.drawRange.count);
      for (let i = 0; i < n; i++) {
        const px = lx + node.steps[4 * i] * step - o.x;
        const py = ly + node.steps[4 * i + 1] * step - o.y;
        const pz = lz + node.steps[4 * i + 2] * step - o.z;
        const t = px * d.x + py * d.y + pz * d.z;
        if (t <= 0.05 || (front && px * ahead.x + py * ahead.y + pz * ahead.z < front)) continue;
        const across = Math.sqrt(Math.max(0, px * px + py * py + pz * pz - t * t)) / t;
        if (across > angle) continue;
        const cost = t * (1 + (4 * across) / angle / 100) + t * across * 2;
        if (cost >= best || hiddenClasses.has(node.codes[4 * i])) continue;
        if (section) {
          const s = (px + o.x - section.place[0]) * along[0] + (py + o.y - section.place[1]) * along[1];
          if (Math.abs(s) > section.thickness / 2) continue;
        }
        best = cost;
        found = { node, index: i };
      }
    }
    if (!found) return null;
    const { node, index } = found;
    node.place(index, place);
    return {
      place: place.toArray() as Place,
      code: node.codes[4 * index],
      confidence: node.codes[4 * index + 1] / 255,
      reference: node.codes[4 * index + 2],
      intensity: node.steps[4 * index + 3],
      object: node.objects[index],
      row: node.rows[index],
    };
  }

  /** Place in the window of a local coordinate, null behind the camera. */
  project(place: Place): { x: number; y: number } | null {
    const seen = new THREE.Vector3(...place).project(this.camera);
    if (seen.z > 1) return null;
    return { x: ((seen.x + 1) / 2) * this.host.clientWidth, y: ((1 - seen.y) / 2) * this.host.clientHeight };
  }
}

function rendererName(gl: WebGLRenderingContext | WebGL2RenderingContext): string {
  const extension = gl.getExtension("WEBGL_debug_renderer_info");
  return String(gl.getParameter(extension ? extension.UNMASKED_RENDERER_WEBGL : gl.RENDERER));
}
