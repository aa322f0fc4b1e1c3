import {
  BufferAttribute, BufferGeometry, DirectionalLight, GridHelper, Group, HemisphereLight, Mesh, MeshStandardMaterial,
  PerspectiveCamera, Quaternion, Scene, Vector3, WebGLRenderer, Box3, Color,
} from "/page/vendor.js"

const GHOST = {color: 0x3b82f6, opacity: 0.28}
const BLEND_MS = 110

/** Read the bodies and meshes of a model from the server's message. */
async function load(path) {
  const answer = await fetch(path)
  if (!answer.ok) throw new Error(await answer.text())
  const data = await answer.arrayBuffer()
  const length = new DataView(data).getUint32(0, true)
  const head = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)))
  return {...head, numbers: data.slice(4 + length)}
}

/** A robot of groups, one for each body. The joints turn and slide the groups. */
class Figure {
  constructor(model, material) {
    this.root = new Group()
    this.joints = new Map()
    this.bodies = []
    const groups = new Map([["world", this.root]])
    for (const body of model.bodies) {
      const group = new Group()
      const [w, x, y, z] = body.quat
      const rest = {position: new Vector3(...body.xyz), turn: new Quaternion(x, y, z, w)}
      this.bodies.push({group, rest, joints: body.joints})
      for (const joint of body.joints) this.joints.set(joint.name, joint.start)
      groups.set(body.name, group)
      ;(groups.get(body.parent) ?? this.root).add(group)
    }
    for (const mesh of model.meshes) groups.get(mesh.body)?.add(new Mesh(geometryOf(model, mesh), material(mesh.rgba)))
    this.pose()
  }

  /** Put the bodies where the joints say. */
  pose() {
    const axis = new Vector3(), anchor = new Vector3(), turn = new Quaternion(), moved = new Vector3()
    for (const {group, rest, joints} of this.bodies) {
      group.position.copy(rest.position)
      group.quaternion.copy(rest.turn)
      for (const joint of joints) {
        const way = (this.joints.get(joint.name) ?? joint.start) - joint.zero
        axis.set(...joint.axis)
        if (joint.slides) group.position.add(axis.multiplyScalar(way).applyQuaternion(group.quaternion))
        else {
          anchor.set(...joint.anchor)
          moved.copy(anchor).applyQuaternion(group.quaternion)
          group.position.add(moved)
          group.quaternion.multiply(turn.setFromAxisAngle(axis, way))
          group.position.sub(moved.copy(anchor).applyQuaternion(group.quaternion))
        }
      }
    }
  }
}

function geometryOf(model, mesh) {
  const points = new Float32Array(model.numbers, mesh.at, mesh.points * 3)
  const faces = new Uint32Array(model.numbers, mesh.at + mesh.points * 12, mesh.faces * 3)
  const geometry = new BufferGeometry()
  geometry.setAttribute("position", new BufferAttribute(points, 3))
  geometry.setIndex(new BufferAttribute(faces, 1))
  const flat = geometry.toNonIndexed()
  flat.computeVertexNormals()
  return flat
}

const solid = rgba => new MeshStandardMaterial({
  color: new Color(rgba[0], rgba[1], rgba[2]), opacity: rgba[3], transparent: rgba[3] < 1, roughness: 0.6, metalness: 0.1})
const ghost = () => new MeshStandardMaterial({...GHOST, transparent: true, depthWrite: false})

/** Draws a robot on a canvas: the measured positions solid, the commanded ones as a ghost. It draws only when
 * something has changed. It needs no document, so it runs in a worker, too. */
export class Drawing {
  constructor(canvas, pixelRatio) {
    this.renderer = new WebGLRenderer({canvas, antialias: true, alpha: true})
    this.renderer.setPixelRatio(pixelRatio)
    this.scene = new Scene()
    this.scene.add(new HemisphereLight(0xffffff, 0x667788, 2.2))
    const sun = new DirectionalLight(0xffffff, 2)
    sun.position.set(1, -1.5, 3)
    this.scene.add(sun)
    this.camera = new PerspectiveCamera(40, 1, 0.01, 200)
    this.goal = new Map()
    this.ended = false
  }

  /** Load the model, and return where its middle is and how large it is. */
  async load(path) {
    const model = await load(path)
    if (this.ended) return null
    this.measured = new Figure(model, solid)
    this.commanded = new Figure(model, ghost)
    this.scene.add(this.measured.root, this.commanded.root)
    const box = new Box3().setFromObject(this.measured.root)
    const middle = box.getCenter(new Vector3()), size = Math.max(box.getSize(new Vector3()).length(), 0.1)
    const grid = new GridHelper(Math.ceil(size * 4), Math.ceil(size * 4) * 5, 0x8899aa, 0x8899aa)
    grid.rotation.x = Math.PI / 2
    grid.material.opacity = 0.25
    grid.material.transparent = true
    this.scene.add(grid)
    return {middle: middle.toArray(), size}
  }

  /** Show a reading: joints with their measured and commanded values, in the robot's units. */
  show({joints, units}) {
    if (!this.measured) return
    const now = performance.now()
    for (const joint of joints) {
      const [zero, scale] = units[joint.name] ?? [0, 0]
      if (!scale) continue
      if (joint.measured != null)
        this.goal.set(joint.name, {from: this.measured.joints.get(joint.name), to: (joint.measured - zero) / scale, at: now})
      if (joint.commanded != null) this.commanded.joints.set(joint.name, (joint.commanded - zero) / scale)
    }
    this.commanded.root.visible = joints.some(joint => joint.commanded != null)
    this.commanded.pose()
    this.wake()
  }

  resize({width, height}) {
    this.renderer.setSize(width, height, false)
    this.camera.aspect = width / height
    this.camera.updateProjectionMatrix()
    this.wake()
  }

  look({position, turn}) {
    this.camera.position.fromArray(position)
    this.camera.quaternion.fromArray(turn)
    this.wake()
  }

  wake() {
    if (this.waiting || this.ended) return
    this.waiting = true
    requestAnimationFrame(() => { this.waiting = false; this.draw() })
  }

  draw() {
    if (this.ended) return
    const now = performance.now()
    let moves = false
    for (const [name, {from, to, at}] of this.goal) {
      const part = Math.min(1, (now - at) / BLEND_MS)
      this.measured.joints.set(name, from + (to - from) * part)
      if (part >= 1) this.goal.delete(name)
      else moves ||= Math.abs(to - from) > 1e-6
    }
    this.measured?.pose()
    this.renderer.render(this.scene, this.camera)
    if (moves) this.wake()
  }

  close() {
    this.ended = true
    this.renderer.dispose()
  }
}
