import {el, setText} from "/page/dom.js"
import {episodeCard} from "/page/episodes.js"

const LOOK_MS = 1000
const OFF = new Set([undefined, "ended"])

/** Record episodes of a robot into a dataset: start the recorder, then keep or discard each episode. */
export class RecorderPanel {
  constructor(name, orders, mayCommand) {
    this.name = name
    this.orders = orders
    this.mayCommand = mayCommand
    this.shown = null
    this.state = el("span", {class: "pill"})
    this.text = el("p", {class: "why", role: "status", "aria-live": "polite"})
    this.cameras = el("span", {class: "row"})
    this.form = this.openForm()
    const press = (word, kind, text, title) =>
      el("button", {class: kind, title, onclick: () => this.press(word)}, text)
    this.start = press("start", "go", "start episode", "gamepad: X")
    this.keep = press("finish", "go", "keep", "ends the episode and saves it. Gamepad: X")
    this.discard = press("discard", "", "discard", "ends the episode and removes it. Gamepad: Y")
    this.again = press("again", "", "again", "discards the episode and starts it anew")
    this.end = press("quit", "quiet", "end the recorder", "saves a running episode")
    this.buttons = el("div", {class: "row orders", hidden: true}, this.start, this.keep, this.discard, this.again, this.end)
    this.episodes = el("ul", {class: "episodes"})
    this.root = el("div", {class: "recorder"}, el("div", {class: "row"}, el("h2", {}, "Record episodes"), this.state),
      mayCommand && this.form, mayCommand && this.buttons, this.text, this.episodes)
    this.timer = setInterval(() => this.look(), LOOK_MS)
    this.look()
  }

  openForm() {
    const dataset = el("input", {name: "dataset", required: true, pattern: "[A-Za-z0-9][A-Za-z0-9._\\-]{0,63}",
      placeholder: "pick-cube", title: "letters, digits, dots and dashes"})
    const task = el("input", {name: "task", required: true, placeholder: "pick the cube up", class: "wide"})
    const fps = el("input", {name: "fps", type: "number", min: 1, max: 240, value: 30, required: true})
    const open = event => {
      event.preventDefault()
      const cameras = [...this.cameras.querySelectorAll("input:checked")].map(box => box.value)
      setText(this.text, "starting the recorder …")
      this.order("open", {dataset: dataset.value.trim(), task: task.value, fps: Number(fps.value), cameras})
    }
    return el("form", {class: "policy", onsubmit: open}, el("label", {}, "dataset", dataset), el("label", {}, "task", task),
      el("label", {}, "fps", fps), this.cameras, el("button", {class: "go"}, "start the recorder"))
  }

  /** The cameras of the robot, which are recorded unless they are unticked. */
  receive(message) {
    if (message.type !== "facts") return
    const {health, presence} = message.topics
    const names = health?.cameras ? Object.keys(health.cameras) : presence?.cameras ?? []
    if (names.join() === this.cameraNames) return
    this.cameraNames = names.join()
    this.cameras.replaceChildren(...names.map(camera =>
      el("label", {class: "tick"}, el("input", {type: "checkbox", value: camera, checked: true}), `camera ${camera}`)))
  }

  /** A button of a gamepad. */
  recorderKey(word) {
    if (OFF.has(this.shown?.state)) return
    this.press(word === "toggle" ? (this.shown.state === "recording" ? "finish" : "start") : word)
  }

  press(word) { return this.order("press", {word}) }

  async order(verb, body) {
    const answer = await this.orders.post(`/robots/${this.name}/recorder/${verb}`, body)
    if (answer) this.show(answer.recorder)
    else this.look()
  }

  async look() {
    if (document.hidden) return
    const answer = await fetch(`/robots/${this.name}/recorder`).then(each => each.ok && each.json()).catch(() => null)
    if (answer) this.show(answer.recorder)
  }

  show(recorder) {
    const before = this.shown
    this.shown = recorder
    const state = recorder?.state
    const isRecording = state === "recording", isOff = OFF.has(state)
    this.form.hidden = !isOff
    this.buttons.hidden = isOff || state === "starting"
    this.start.hidden = isRecording
    this.keep.hidden = this.discard.hidden = this.again.hidden = !isRecording
    this.root.classList.toggle("recording", isRecording)
    setText(this.state, isRecording ? `● episode ${recorder.episode}, ${Math.round(recorder.seconds)} s` : state ?? "off")
    setText(this.text, recorder?.text ?? "")
    if (recorder && (before?.saved !== recorder.saved || before?.dataset !== recorder.dataset)) this.list(recorder.dataset)
  }

  async list(dataset) {
    const answer = await fetch(`/recordings/${dataset}/episodes`).then(each => each.ok && each.json()).catch(() => null)
    if (answer) this.episodes.replaceChildren(...answer.episodes.map(episode => episodeCard(dataset, episode)))
  }

  close() { clearInterval(this.timer) }
}
