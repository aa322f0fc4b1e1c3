import {el, setText} from "/page/dom.js"

const PERIOD_MS = 1000
const AGAIN_MS = 5000

/** The processes and actors of a robot, with their restarts. It is asked for while it is open. */
export class ActorTree {
  constructor(name) {
    this.name = name
    this.rows = new Map()
    this.why = el("p", {class: "why", role: "status"})
    this.body = el("tbody")
    this.table = el("table", {class: "tree", hidden: true}, el("thead", {}, el("tr", {},
      ["process or actor", "state", "restarts"].map(text => el("th", {scope: "col"}, text)))), this.body)
    this.root = el("details", {ontoggle: () => this.root.open && this.look()},
      el("summary", {}, el("h2", {}, "Processes and actors")), this.why, this.table)
  }

  async look() {
    clearTimeout(this.timer)
    if (!this.root.open || this.isClosed) return
    let isShown = false
    try {
      const answer = await fetch(`/robots/${encodeURIComponent(this.name)}/tree`)
      isShown = answer.ok
      if (answer.ok) this.show(await answer.json())
      else setText(this.why, await answer.text())
    } catch (problem) {
      setText(this.why, `no answer (${problem.message})`)
    }
    this.table.hidden = !isShown
    if (!this.isClosed) this.timer = setTimeout(() => this.look(), isShown ? PERIOD_MS : AGAIN_MS)
  }

  show(tree) {
    setText(this.why, tree.state === "unreachable" ? "The root process does not answer." : "")
    const rows = tree.processes.flatMap(process => [
      {key: `process ${process.role} ${process.pid}`, text: process.role, note: `pid ${process.pid}`, ...process, isProcess: true},
      ...tree.actors.filter(actor => actor.pid === process.pid).map(actor => ({
        ...actor, key: `${actor.address} ${actor.pid}`, text: actor.address.split("/actor/")[1] ?? actor.address, note: "",
        state: process.state === "running" ? actor.state : process.state})),
    ])
    this.body.replaceChildren(...rows.map(row => this.row(row)))
    for (const key of this.rows.keys()) if (!rows.some(row => row.key === key)) this.rows.delete(key)
  }

  row({key, text, note, state, restarts, isProcess}) {
    if (!this.rows.has(key)) {
      const cells = {state: el("td"), restarts: el("td", {class: "number"})}
      const root = el("tr", {class: isProcess ? "process" : ""},
        el("th", {scope: "row"}, text, note && el("small", {}, note)), cells.state, cells.restarts)
      this.rows.set(key, {root, ...cells})
    }
    const shown = this.rows.get(key)
    setText(shown.state, state)
    shown.state.className = ["frozen", "ended", "failed"].includes(state) ? "bad" : ""
    setText(shown.restarts, restarts ? String(restarts) : "–")
    shown.restarts.classList.toggle("some", restarts > 0)
    return shown.root
  }

  close() {
    this.isClosed = true
    clearTimeout(this.timer)
  }
}
