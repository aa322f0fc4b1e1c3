import {OrbitControls, PerspectiveCamera, Vector3} from "/page/vendor.js"

const DIRECTION = [1, -1.3, 0.7]
const DISTANCE = 1.7

/** Draws in a worker, so that a slow drawing blocks no jog button. It has the calls of `Drawing`. */
class FarDrawing {
  constructor(canvas, pixelRatio) {
    this.worker = new Worker("/page/worker.js", {type: "module"})
    this.loaded = new Promise((done, failed) => {
      this.worker.onmessage = ({data}) => (data.problem ? failed(new Error(data.problem)) : done(data.loaded))
      this.worker.onerror = event => failed(new Error(event.message || "the worker that draws has failed"))
    })
    const offscreen = canvas.transferControlToOffscreen()
    this.worker.postMessage({call: "open", value: {canvas: offscreen, pixelRatio}}, [offscreen])
  }

  call(name, value) { this.worker.postMessage({call: name, value}) }

  load(path) { this.call("load", path); return this.loaded }
  show(reading) { this.call("show", reading) }
  resize(size) { this.call("resize", size) }
  look(view) { this.call("look", view) }
  close() { this.worker.terminate() }
}

/** True if this browser can draw in 3-D in a worker. Some have such a canvas, but only for 2-D. */
const canDrawFar = Boolean(globalThis.OffscreenCanvas && new OffscreenCanvas(1, 1).getContext("webgl2"))

async function drawingOn(canvas) {
  const ratio = Math.min(devicePixelRatio, 2)
  if (canDrawFar) return new FarDrawing(canvas, ratio)
  const {Drawing} = await import("/page/drawing.js")
  return new Drawing(canvas, ratio)
}

/** The robot in 3-D. The mouse turns a camera here, and the drawing follows it. */
export class RobotScene {
  constructor(canvas) {
    this.canvas = canvas
    this.camera = new PerspectiveCamera()
    this.camera.up.set(0, 0, 1)
    this.controls = new OrbitControls(this.camera, canvas)
    this.controls.addEventListener("change", () => this.look())
    this.sizes = new ResizeObserver(() => this.resize())
    this.sizes.observe(canvas.parentElement)
    this.ended = false
  }

  async load(path) {
    const drawing = await drawingOn(this.canvas)
    if (this.ended) { drawing.close(); return }
    this.drawing = drawing
    this.resize()
    const loaded = await drawing.load(path)
    if (!loaded || this.ended) return
    const middle = new Vector3(...loaded.middle)
    this.controls.target.copy(middle)
    this.camera.position.copy(middle).add(new Vector3(...DIRECTION).normalize().multiplyScalar(loaded.size * DISTANCE))
    this.controls.update()
    this.look()
  }

  /** Show a reading: joints with their measured and commanded values, in the robot's units. */
  show(joints, units) {
    this.drawing?.show({joints, units})
  }

  look() {
    this.drawing?.look({position: this.camera.position.toArray(), turn: this.camera.quaternion.toArray()})
  }

  resize() {
    const {clientWidth: width, clientHeight: height} = this.canvas.parentElement
    if (width && height) this.drawing?.resize({width, height})
  }

  close() {
    this.ended = true
    this.sizes.disconnect()
    this.controls.dispose()
    this.drawing?.close()
  }
}
