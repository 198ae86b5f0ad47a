// The paper's Fig. 4(a): the corridor in three dimensions. x as in the top view, z away from the viewer, y up.

import {
  AmbientLight, BoxGeometry, CircleGeometry, Color, CylinderGeometry, DirectionalLight, DoubleSide, GridHelper, Group,
  HemisphereLight, Mesh, MeshBasicMaterial, MeshStandardMaterial, Object3D, PCFShadowMap, PerspectiveCamera, PlaneGeometry,
  RingGeometry, Scene, SphereGeometry, Vector3, WebGLRenderer,
} from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
import { Line2 } from "three/examples/jsm/lines/Line2.js";
import { LineGeometry } from "three/examples/jsm/lines/LineGeometry.js";
import { LineMaterial } from "three/examples/jsm/lines/LineMaterial.js";
import { Track } from "./data";
import { Theme } from "./theme";

const WALL = 0.3;
const WALL_HEIGHT = 0.7;

export class View3D {
  private readonly renderer: WebGLRenderer;
  private readonly scene = new Scene();
  private readonly camera = new PerspectiveCamera(28, 1.6, 0.1, 500);
  private readonly controls: OrbitControls;
  private readonly ambient = new AmbientLight(0xffffff, 0.55);
  private readonly sky = new HemisphereLight(0xffffff, 0xd8d4cc, 1.1);
  private readonly sun = new DirectionalLight(0xffffff, 2.0);
  private world = new Group();
  private learner!: Mesh;
  private opponents: Mesh[] = [];
  private zones: Mesh[] = [];
  private pad: Mesh | null = null;
  private trails: { line: Line2; name: string; rows: number }[] = [];
  private built: { track: Track; theme: Theme } | null = null;
  private homeAspect = 0; // that the camera was placed for; 0 before, NaN once the user has moved it
  private followed: Vector3 | null = null; // where the learner was when the camera last went with it

  // Throws where there is no WebGL.
  constructor(private readonly canvas: HTMLCanvasElement, onChange: () => void) {
    const context = canvas.getContext("webgl2", { antialias: true });
    if (!context) throw new Error("no WebGL"); // three.js would also complain to the console
    this.renderer = new WebGLRenderer({ canvas, context });
    this.renderer.shadowMap.enabled = true;
    this.renderer.shadowMap.type = PCFShadowMap;
    // The page scrolls under a wheel and under a finger that goes up or down; Ctrl and the wheel, or two fingers, zoom.
    const scrolls = (event: WheelEvent) => {
      if (!event.ctrlKey && !event.metaKey) event.stopImmediatePropagation();
    };
    canvas.addEventListener("wheel", scrolls, { capture: true, passive: true });
    this.controls = new OrbitControls(this.camera, canvas);
    canvas.style.touchAction = "pan-y";
    // A finger whose first way was taken for a turn, before it scrolled: the camera is where it was.
    let before = { position: new Vector3(), target: new Vector3(), homeAspect: 0 };
    canvas.addEventListener("pointerdown", (event) => {
      if (!event.isPrimary) return;
      before = { position: this.camera.position.clone(), target: this.controls.target.clone(), homeAspect: this.homeAspect };
    }, { capture: true });
    canvas.addEventListener("pointercancel", (event) => {
      if (!event.isPrimary) return;
      this.camera.position.copy(before.position);
      this.controls.target.copy(before.target);
      this.controls.update();
      this.homeAspect = before.homeAspect;
      onChange();
    });
    this.controls.enableDamping = false;
    this.controls.maxPolarAngle = 1.5;
    this.controls.addEventListener("change", onChange);
    this.controls.addEventListener("start", () => (this.homeAspect = NaN));
    this.sun.castShadow = true;
    this.sun.shadow.mapSize.set(2048, 1024);
    this.sun.shadow.radius = 3;
    this.sun.shadow.bias = -0.001;
    this.sun.shadow.normalBias = 0.06;
    this.scene.add(this.ambient, this.sky, this.sun, this.sun.target, this.world);
  }

  // From above and in front, just far enough for all four corners to be in the picture.
  resetCamera(corridor: Track["corridor"]): void {
    const [x, z] = [corridor.half_length + WALL, corridor.half_width + WALL];
    const corners = [-1, 1].flatMap((side) => [-1, 1].map((end) => new Vector3(side * x, WALL_HEIGHT / 2, end * z)));
    this.controls.target.set(0, 0, 0.12 * corridor.half_width);
    for (let distance = z; distance < 100 * x; distance *= 1.02) {
      this.camera.position.set(0, distance, 0.8 * distance).add(this.controls.target);
      this.camera.lookAt(this.controls.target);
      this.camera.updateMatrixWorld();
      if (corners.every((corner) => { const at = corner.clone().project(this.camera); return Math.abs(at.x) < 0.96 && Math.abs(at.y) < 0.92; })) {
        this.controls.minDistance = 2;
        this.controls.maxDistance = 4 * distance;
        break;
      }
    }
    this.homeAspect = this.camera.aspect;
    this.controls.update();
  }

  get following(): boolean {
    return this.followed !== null;
  }

  get lookedAt(): number[] {
    return this.controls.target.toArray();
  }

  // Lets the camera go with the learner, from nearer by; without, it stays where it is.
  setFollowing(on: boolean, corridor?: Track["corridor"]): void {
    if (on === this.following || !corridor) return;
    if (on) {
      this.homeAspect = NaN;
      this.followed = new Vector3().copy(this.learner?.position ?? this.controls.target);
      const nearer = this.camera.position.clone().sub(this.controls.target).multiplyScalar(0.45);
      this.controls.target.copy(this.followed);
      this.camera.position.copy(this.followed).add(nearer);
      this.controls.update();
    } else this.followed = null;
  }

  draw(track: Track, time: number, theme: Theme): void {
    const width = this.canvas.clientWidth;
    const height = this.canvas.clientHeight;
    if (!width || !height) return;
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    const size = this.canvas.width !== Math.floor(width * ratio) || this.canvas.height !== Math.floor(height * ratio);
    if (size) {
      this.renderer.setPixelRatio(ratio);
      this.renderer.setSize(width, height, false);
      this.camera.aspect = width / height;
      this.camera.updateProjectionMatrix();
    }
    if (!this.built || this.built.track !== track || this.built.theme !== theme) this.build(track, theme);
    if (this.homeAspect === 0 || (size && this.homeAspect !== this.camera.aspect && !isNaN(this.homeAspect))) this.resetCamera(track.corridor);

    const c = track.corridor;
    const row = Math.min(Math.floor(time), track.rows - 1);
    place(this.learner, track.place("p", time), c.agent_radius);
    if (this.followed) {
      const moved = this.learner.position.clone().sub(this.followed);
      this.followed.copy(this.learner.position);
      this.controls.target.add(moved);
      this.camera.position.add(moved);
      this.camera.lookAt(this.controls.target);
    }
    this.opponents.forEach((mesh, k) => {
      const at = track.place(`op${k}`, time);
      place(mesh, at, c.opponent_radius);
      place(this.zones[k], at, 0.02);
      (this.zones[k].children[0] as Mesh<RingGeometry, MeshBasicMaterial>).material.opacity =
        track.at(`op${k}_d`, row) < c.near_distance ? 0.38 : 0.1;
    });
    if (this.pad) {
      const on = track.at("switch", row) > 0.5;
      const material = this.pad.material as MeshStandardMaterial;
      material.color.set(on ? theme.switch : theme.grid);
      material.emissive.set(on ? theme.switch : 0x000000);
      material.emissiveIntensity = on ? 0.35 : 0;
    }
    for (const trail of this.trails) this.follow(trail, track, time);
    this.renderer.render(this.scene, this.camera);
  }

  private build(track: Track, theme: Theme): void {
    this.built = { track, theme };
    dispose(this.world);
    this.scene.remove(this.world);
    this.world = new Group();
    this.scene.add(this.world);
    this.scene.background = new Color(theme.sky);
    this.ambient.intensity = theme.dark ? 0.35 : 0.55;
    this.sky.intensity = theme.dark ? 0.8 : 1.1;

    const c = track.corridor;
    const floor = new Mesh(
      new PlaneGeometry(2 * c.half_length, 2 * c.half_width),
      new MeshStandardMaterial({ color: theme.floor, roughness: 0.95 }),
    );
    floor.rotation.x = -Math.PI / 2;
    floor.receiveShadow = true;
    const around = new Mesh(
      new PlaneGeometry(40 * c.half_length, 40 * c.half_length),
      new MeshBasicMaterial({ color: theme.sky }),
    );
    around.rotation.x = -Math.PI / 2;
    around.position.y = -0.05;
    const grid = new GridHelper(2 * c.half_length, 10, theme.grid, theme.grid);
    grid.scale.z = c.half_width / c.half_length;
    grid.position.y = 0.005;
    this.world.add(around, floor, grid);
    const walls = new MeshStandardMaterial({ color: theme.wall, roughness: 0.8 });
    for (const side of [-1, 1]) {
      this.box(2 * c.half_length + 2 * WALL, WALL_HEIGHT, WALL, walls, 0, side * (c.half_width + WALL / 2));
      this.box(WALL, WALL_HEIGHT, 2 * c.half_width, walls, side * (c.half_length + WALL / 2), 0);
    }

    this.pad = null;
    if (c.switch) {
      const { x, z, radius } = c.switch;
      const rim = new Mesh(new CylinderGeometry(radius, radius, 0.06, 64), new MeshStandardMaterial({ color: theme.switch, roughness: 0.7 }));
      place(rim, [x, z], 0.03);
      this.pad = new Mesh(new CylinderGeometry(0.86 * radius, 0.86 * radius, 0.1, 64), new MeshStandardMaterial({ roughness: 0.6 }));
      place(this.pad, [x, z], 0.05);
      rim.receiveShadow = this.pad.receiveShadow = true;
      this.world.add(rim, this.pad);
    }
    for (const target of track.targets ?? []) this.target(target, c.opponent_radius, theme.opponent);
    this.target(track.goal, c.agent_radius, theme.learner);
    const reach = new Mesh(
      new RingGeometry(c.goal_radius - 0.05, c.goal_radius + 0.05, 64),
      new MeshBasicMaterial({ color: theme.learner, side: DoubleSide }),
    );
    reach.rotation.x = -Math.PI / 2;
    place(reach, track.goal, 0.015);
    this.world.add(reach);

    this.learner = this.sphere(c.agent_radius, theme.learner);
    this.opponents = [];
    this.zones = [];
    const near = c.near_distance * c.half_length;
    for (let k = 0; k < track.opponents; k++) {
      this.opponents.push(this.sphere(c.opponent_radius, theme.opponent));
      const zone = new Mesh(new RingGeometry(near - 0.04, near, 96), new MeshBasicMaterial({ color: theme.opponent, side: DoubleSide }));
      const inner = new Mesh(
        new CircleGeometry(near - 0.04, 96),
        new MeshBasicMaterial({ color: theme.opponent, transparent: true, opacity: 0.1, depthWrite: false }),
      );
      zone.add(inner);
      zone.rotation.x = -Math.PI / 2;
      this.world.add(zone);
      this.zones.push(zone);
    }
    this.trails = ["p", ...this.opponents.map((_, k) => `op${k}`)].map((name) => {
      const material = new LineMaterial({ color: name === "p" ? theme.learner : theme.opponent, linewidth: 0.11, worldUnits: true });
      const line = new Line2(new LineGeometry(), material);
      line.frustumCulled = false;
      this.world.add(line);
      return { line, name, rows: 0 };
    });

    this.sun.position.set(-0.5 * c.half_length, 1.3 * c.half_length, 0.45 * c.half_length);
    Object.assign(this.sun.shadow.camera, {
      left: -c.half_length - 1, right: c.half_length + 1, top: c.half_length, bottom: -c.half_length, near: 1, far: 4 * c.half_length,
    });
    this.sun.shadow.camera.updateProjectionMatrix();
  }

  // The path so far, on the floor. All of a recorded path is uploaded once; each frame only says how much to draw.
  private follow(trail: (typeof this.trails)[number], track: Track, time: number): void {
    if (trail.rows !== track.rows && track.rows > 1) {
      const scale = track.corridor.half_length;
      const points: number[] = [];
      for (let row = 0; row < track.rows; row++)
        points.push(track.at(`${trail.name}_x`, row) * scale, 0.03, -track.at(`${trail.name}_z`, row) * scale);
      trail.line.geometry.dispose();
      trail.line.geometry = new LineGeometry();
      trail.line.geometry.setPositions(points);
      trail.rows = track.rows;
    }
    trail.line.geometry.instanceCount = Math.ceil(time);
    trail.line.visible = time > 0 && track.rows > 1;
  }

  private box(x: number, y: number, z: number, material: MeshStandardMaterial, atX: number, atZ: number): void {
    const mesh = new Mesh(new BoxGeometry(x, y, z), material);
    place(mesh, [atX, atZ], y / 2);
    this.world.add(mesh);
  }

  private sphere(radius: number, colour: string): Mesh {
    const mesh = new Mesh(new SphereGeometry(radius, 40, 24), new MeshStandardMaterial({ color: colour, roughness: 0.38 }));
    mesh.castShadow = true;
    this.world.add(mesh);
    return mesh;
  }

  private target(at: [number, number], half: number, colour: string): void {
    const mesh = new Mesh(
      new BoxGeometry(2 * half, 2 * half, 2 * half),
      new MeshStandardMaterial({ color: colour, transparent: true, opacity: 0.5, roughness: 0.6, depthWrite: false }),
    );
    place(mesh, at, half + 0.01);
    this.world.add(mesh);
  }
}

function place(object: Object3D, [x, z]: readonly [number, number], y: number): void {
  object.position.set(x, y, -z);
}

function dispose(group: Group): void {
  group.traverse((object) => {
    if (object instanceof Mesh) {
      object.geometry.dispose();
      for (const material of [object.material].flat()) material.dispose();
    }
  });
}
