const DEAD_ZONE = 0.12
const SHOULDERS = [4, 5, 6, 7]
const START = 2, DISCARD = 3, BACK = 8

/** The first gamepad whose dead-man, a shoulder button, is held. `press` gets the words of the recorder's buttons. */
export class Gamepads {
  constructor(axes, tool, press) {
    this.axes = axes
    this.tool = tool
    this.movesTool = false // true: the gamepad moves the tool of the arm, false: its joints
    this.text = ""
    this.wasDown = new Set()
    // True after the page lost the focus. The browser may then report old states, so a held dead-man is no new press.
    this.isAway = false
    this.actions = {
      [START]: () => press("toggle"), [DISCARD]: () => press("discard"),
      [BACK]: () => { this.movesTool = !this.movesTool && tool.length > 0 },
    }
  }

  /** Note that the page was hidden, or lost the focus. */
  leave() { this.isAway = true }

  /** Return the rates by axis while a dead-man is held, else null. */
  read() {
    if (!document.hasFocus()) { this.leave(); return null }
    this.text = ""
    for (const pad of navigator.getGamepads?.() ?? []) {
      if (!pad?.connected) continue
      this.callActions(pad)
      this.text = `gamepad: ${pad.id}${this.tool.length ? `, moves the ${this.movesTool ? "tool" : "joints"}` : ""}`
      if (!SHOULDERS.some(at => pad.buttons[at]?.pressed)) continue
      return this.isAway ? null : this.ratesOf(pad)
    }
    this.isAway = false
    return null
  }

  /** Call the action of each button once, when it goes down. */
  callActions(pad) {
    for (const at in this.actions) {
      const name = `${pad.index} ${at}`
      if (!pad.buttons[at]?.pressed) this.wasDown.delete(name)
      else if (!this.wasDown.has(name)) { this.wasDown.add(name); this.actions[at]() }
    }
  }

  ratesOf(pad) {
    const stick = at => { const value = pad.axes[at] ?? 0; return Math.abs(value) < DEAD_ZONE ? 0 : value }
    const pair = (up, under) => (pad.buttons[up]?.pressed ? 1 : 0) - (pad.buttons[under]?.pressed ? 1 : 0)
    if (this.movesTool) { // ahead, to the left, up; the last axis of the robot is mostly its gripper
      const turns = {"ee.wx": pair(15, 14), "ee.wy": pair(13, 12), "ee.wz": -stick(2)}
      return {"ee.x": -stick(1), "ee.y": -stick(0), "ee.z": -stick(3), ...turns, [this.axes.at(-1)]: pair(0, 1)}
    }
    const rates = [stick(0), -stick(1), -stick(3), pair(12, 13), stick(2), pair(0, 1)]
    return Object.fromEntries(this.axes.slice(0, rates.length).map((axis, at) => [axis, rates[at]]))
  }
}
