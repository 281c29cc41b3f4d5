// Points in chunks, whose buffers are filled part by part; what is drawn of them in one slice.
//
// A point is written once and uploaded once, when its chunk is drawn next. One in THIN is kept a second time: those of
// all chunks stand for the wall until there was time for the others.

import * as THREE from "./vendor/three/three.module.min.js";

export const CHUNK = 50_000; // points
const THIN = 40;
const THIN_CHUNK = CHUNK / THIN;

class Cells {
  constructor(room, material) {
    this.geometry = new THREE.BufferGeometry();
    this.position = new THREE.BufferAttribute(new Float32Array(3 * room), 3);
    this.colour = new THREE.BufferAttribute(new Uint8Array(3 * room), 3, true);
    for (const attribute of [this.position, this.colour]) attribute.setUsage(THREE.DynamicDrawUsage);
    this.geometry.setAttribute("position", this.position);
    this.geometry.setAttribute("color", this.colour);
    this.points = new THREE.Points(this.geometry, material);
    this.points.frustumCulled = false; // its bounds change with every frame
    this.points.matrixAutoUpdate = false;
    this.points.visible = false;
    this.used = 0;
    this.uploaded = 0;
  }

  // Of the points from..to, each `every`-th.
  add(xyz, rgb, from, to, every = 1) {
    if (every === 1) {
      this.position.array.set(xyz.subarray(3 * from, 3 * to), 3 * this.used);
      this.colour.array.set(rgb.subarray(3 * from, 3 * to), 3 * this.used);
      this.used += to - from;
      return;
    }
    for (let i = from; i < to; i += every) {
      for (let c = 0; c < 3; c++) {
        this.position.array[3 * this.used + c] = xyz[3 * i + c];
        this.colour.array[3 * this.used + c] = rgb[3 * i + c];
      }
      this.used += 1;
    }
  }

  show(from) {
    this.points.visible = this.used > from;
    if (!this.points.visible) return 0;
    this.geometry.setDrawRange(from, this.used - from);
    if (this.uploaded < this.used) {
      for (const attribute of [this.position, this.colour]) {
        attribute.clearUpdateRanges();
        attribute.addUpdateRange(3 * this.uploaded, 3 * (this.used - this.uploaded));
        attribute.needsUpdate = true;
      }
      this.uploaded = this.used;
    }
    return this.used - from;
  }

  forget() {
    this.used = this.uploaded = 0;
    this.points.visible = false;
  }
}

class Chunk {
  constructor(material) {
    this.all = new Cells(CHUNK, material);
    this.thin = new Cells(THIN_CHUNK, material);
    this.drawn = 0; // points of the picture as it stands
  }

  forget() {
    this.all.forget();
    this.thin.forget();
    this.drawn = 0;
  }
}

export class Chunks {
  constructor(pointsMax, material) {
    this.most = Math.floor(pointsMax / CHUNK);
    this.material = material;
    this.group = new THREE.Group();
    this.group.matrixAutoUpdate = false;
    this.shown = []; // oldest first
    this.staged = null; // the ones that will be shown instead
    this.spare = [];
    this.held = 0;
  }

  // What comes from now on will take the place of all that is there, at `shift`.
  stage() {
    if (this.staged) this.putAway(this.staged);
    this.staged = [];
  }

  // Whether anything took the place of anything.
  shift() {
    if (!this.staged) return false;
    this.putAway(this.shown);
    this.shown = this.staged;
    this.staged = null;
    this.held = this.shown.reduce((sum, one) => sum + one.all.used, 0);
    return true;
  }

  // (3N) mm, (3N). Returns false once there is no room for all of them.
  add(xyz, rgb) {
    const into = this.staged ?? this.shown;
    const count = xyz.length / 3;
    for (let at = 0; at < count; ) {
      let last = into.at(-1);
      if (!last || last.all.used === CHUNK) {
        if (into.length === this.most) return false;
        last = this.spare.pop() ?? this.make();
        into.push(last);
      }
      const end = Math.min(count, at + CHUNK - last.all.used);
      const off = (THIN - (last.all.used % THIN)) % THIN;
      last.thin.add(xyz, rgb, at + off, end, THIN);
      last.all.add(xyz, rgb, at, end);
      if (!this.staged) this.held += end - at;
      at = end;
    }
    return true;
  }

  // Shows the first slice of a picture; how many points it has. At least a few of every chunk, all of the newest.
  begin(most) {
    let left = most;
    for (const chunk of this.shown) left -= chunk.thin.used;
    let points = 0;
    for (let n = this.shown.length - 1; n >= 0; n--) {
      const { all, thin } = this.shown[n];
      const whole = n === this.shown.length - 1 || all.used - thin.used <= left;
      if (whole) left -= all.used - thin.used;
      else left = 0;
      points += (whole ? all : thin).show(0);
      (whole ? thin : all).points.visible = false;
      this.shown[n].drawn = whole ? all.used : 0;
    }
    return points;
  }

  // Shows what comes on top of it: newest first, `most` points or one chunk; 0 when all is there.
  more(most) {
    let points = 0;
    for (let n = this.shown.length - 1; n >= 0; n--) {
      const chunk = this.shown[n];
      chunk.thin.points.visible = chunk.all.points.visible = false;
      const left = chunk.all.used - chunk.drawn;
      if (left === 0 || (points > 0 && points + left > most)) continue;
      points += chunk.all.show(chunk.drawn);
      chunk.drawn = chunk.all.used;
    }
    return points;
  }

  make() {
    const chunk = new Chunk(this.material);
    this.group.add(chunk.all.points, chunk.thin.points);
    return chunk;
  }

  putAway(chunks) {
    for (const chunk of chunks) chunk.forget();
    this.spare.push(...chunks);
  }
}
