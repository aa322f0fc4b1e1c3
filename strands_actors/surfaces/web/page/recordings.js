import {el, number, setText} from "/page/dom.js"
import {drawJoints, episodeCard} from "/page/episodes.js"
import {RobotScene} from "/page/scene.js"

const SPEEDS = [0.25, 0.5, 1, 2, 4]

/** The datasets and recordings of this computer. An episode is played in 3-D on a time line, without any robot. */
export class Recordings {
  constructor(orders) {
    this.orders = orders
    const [, , name, episode] = location.hash.split("/").map(decodeURIComponent)
    this.root = el("div", {class: "recordings"})
    if (name) this.open(name, episode)
    else this.list()
  }

  async list() {
    const answer = await this.orders.get("/recordings")
    if (!answer) return
    this.root.replaceChildren(el("h1", {}, "Recordings"),
      el("p", {class: "empty", hidden: answer.recordings.length > 0},
        "There are none yet. Record episodes on the page of a robot, or put a dataset or a recording into ",
        el("code", {}, answer.folder), "."),
      el("section", {class: "grid"}, answer.recordings.map(one => el("article", {class: "card"},
        el("h2", {}, el("a", {href: `#/recordings/${one.name}`}, one.name)),
        el("p", {class: "dim"}, one.is_dataset ? "dataset: " : "recording: ", one.about)))))
  }

  async open(name, episode) {
    const title = el("h1", {}, el("a", {href: "#/recordings"}, "Recordings"), " / ", name)
    if (name.endsWith(".mcap")) {
      this.root.replaceChildren(title, this.player(`/recordings/${name}/track`))
      return
    }
    const answer = await this.orders.get(`/recordings/${name}/episodes`)
    if (!answer) return
    const shown = episode ?? answer.episodes[0]?.number
    this.root.replaceChildren(title,
      shown == null ? el("p", {class: "empty"}, "This dataset has no episodes.")
        : this.player(`/recordings/${name}/episodes/${shown}`, `episode ${shown}`),
      el("ul", {class: "episodes"}, answer.episodes.map(each => episodeCard(name, each))))
  }

  player(path, title = "") {
    this.shownPlayer?.close()
    this.shownPlayer = new Player(this.orders, path, title)
    return this.shownPlayer.root
  }

  close() { this.shownPlayer?.close() }
}

/** Plays one track in 3-D on a time line. */
class Player {
  constructor(orders, path, title) {
    this.at = 0 // seconds
    this.speed = 1
    this.canvas = el("canvas", {"aria-label": "the robot in 3-D", role: "img"})
    this.note = el("p", {class: "no-model"}, "reading …")
    this.slider = el("input", {type: "range", min: 0, max: 1, step: 0.01, value: 0, "aria-label": "time",
      oninput: () => { this.pause(); this.seek(Number(this.slider.value)) }})
    this.play = el("button", {class: "go", onclick: () => this.toggle()}, "play")
    this.time = el("span", {class: "value"})
    this.lines = el("canvas", {width: 900, height: 110, role: "img", "aria-label": "the joints over time"})
    this.cursor = el("i")
    this.table = el("table", {class: "joints"})
    const speed = el("select", {"aria-label": "speed", onchange: () => { this.speed = Number(speed.value) }},
      SPEEDS.map(each => el("option", {value: each, selected: each === 1}, `${each} ×`)))
    this.task = el("p", {class: "dim"})
    this.root = el("div", {class: "robot"},
      el("section", {class: "stage"}, this.canvas, this.note),
      el("section", {class: "side"}, title && el("h2", {}, title), this.task, this.table),
      el("section", {class: "below timeline"}, el("div", {class: "row"}, this.play, this.slider, this.time, speed),
        el("div", {class: "lines"}, this.lines, this.cursor)))
    this.scene = new RobotScene(this.canvas)
    this.load(orders, path)
  }

  async load(orders, path) {
    const track = await orders.get(path)
    if (!track || this.ended) return
    this.track = track
    this.length = track.times.at(-1) ?? 0
    this.slider.max = this.length
    setText(this.task, track.task)
    this.cells = track.joints.map(joint => {
      const cells = [el("td", {class: "value"}), el("td", {class: "value goal"})]
      this.table.append(el("tr", {}, el("th", {scope: "row"}, joint), cells))
      return cells
    })
    drawJoints(this.lines, track)
    this.seek(0)
    if (!track.robot_type || !Object.keys(track.units).length) {
      setText(this.note, "No model of this robot is known here, so only its joints are shown.")
      return
    }
    setText(this.note, "reading the model …")
    await this.scene.load(`/scenes/${track.robot_type}`).then(() => { this.note.hidden = true })
      .catch(problem => setText(this.note, problem.message))
    this.seek(this.at)
  }

  /** Show the moment at a time in seconds. */
  seek(at) {
    this.at = Math.min(this.length, Math.max(0, at))
    const {times, joints, measured, commanded, units} = this.track
    let low = 0, high = times.length - 1
    while (low < high) {
      const middle = (low + high + 1) >> 1
      if (times[middle] <= this.at) low = middle
      else high = middle - 1
    }
    if (!times.length) return
    this.scene.show(joints.map((name, joint) =>
      ({name, measured: measured[low][joint], commanded: commanded[low][joint]})), units)
    joints.forEach((_, joint) => {
      setText(this.cells[joint][0], number(measured[low][joint]))
      setText(this.cells[joint][1], number(commanded[low][joint]))
    })
    this.slider.value = this.at
    this.cursor.style.left = `${this.length ? this.at / this.length * 100 : 0}%`
    setText(this.time, `${number(this.at)} of ${number(this.length)} s`)
  }

  toggle() {
    if (this.frame) { this.pause(); return }
    if (this.at >= this.length) this.at = 0
    setText(this.play, "pause")
    let before = performance.now()
    const step = now => {
      this.seek(this.at + (now - before) / 1000 * this.speed)
      before = now
      if (this.at < this.length) this.frame = requestAnimationFrame(step)
      else this.pause()
    }
    this.frame = requestAnimationFrame(step)
  }

  pause() {
    cancelAnimationFrame(this.frame)
    this.frame = 0
    setText(this.play, "play")
  }

  close() {
    this.ended = true
    this.pause()
    this.scene.close()
  }
}
