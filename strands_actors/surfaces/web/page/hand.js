import {el} from "/page/dom.js"

const TURN_MS = 33

/** The operator's hand on buttons and gamepads. It moves the robot while it is held, and its release, loss or blur
 * ends that. `send` gets (held, rates): 30 times a second while it is held, and once when it is let go. With
 * `isSteady` it gets them always. */
export class Hand {
  constructor(send, isSteady = false) {
    this.send = send
    this.isSteady = isSteady
    this.speed = 0.5
    this.pads = null
    this.down = new Map()
    this.isHeld = false
    this.letGo = () => this.release()
    addEventListener("blur", this.letGo)
    document.addEventListener("visibilitychange", this.letGo)
    this.timer = setInterval(() => this.turn(), TURN_MS)
  }

  /** Return a button that moves an axis up or down. `pressed` is called when it goes down. */
  button(axis, sign, pressed = () => {}) {
    const key = `${axis}${sign}`
    const press = event => {
      if (event.button > 0) return
      event.preventDefault()
      if (event.pointerId != null) button.setPointerCapture(event.pointerId)
      if (this.down.has(key)) return
      this.down.set(key, {axis, sign, button})
      button.classList.add("down")
      pressed()
      this.turn()
    }
    const lift = () => {
      button.classList.remove("down")
      if (this.down.delete(key) && !this.down.size) this.turn()
    }
    const button = el("button", {
      class: "jog", "aria-label": `${axis} ${sign > 0 ? "up" : "down"}`, onpointerdown: press,
      oncontextmenu: event => event.preventDefault(),
      onkeydown: event => { if (event.key === "Enter" && !event.repeat) press(event) },
      onkeyup: event => { if (event.key === "Enter") lift() },
    }, sign > 0 ? "+" : "−")
    for (const end of ["pointerup", "pointercancel", "lostpointercapture", "blur"]) button.addEventListener(end, lift)
    return button
  }

  turn() {
    if (document.hidden) { this.pads?.leave(); return }
    const rates = {}
    for (const {axis, sign} of this.down.values()) rates[axis] = (rates[axis] ?? 0) + sign * this.speed
    const pad = this.pads?.read() ?? null
    for (const axis in pad) rates[axis] = (rates[axis] ?? 0) + pad[axis] * this.speed
    const held = this.down.size > 0 || pad !== null
    if (held || this.isHeld || this.isSteady) this.send(held, rates)
    this.isHeld = held
  }

  release() {
    for (const {button} of this.down.values()) button.classList.remove("down")
    this.down.clear()
    this.isHeld = false
    this.send(false, {})
  }

  close() {
    this.release()
    clearInterval(this.timer)
    removeEventListener("blur", this.letGo)
    document.removeEventListener("visibilitychange", this.letGo)
  }
}
