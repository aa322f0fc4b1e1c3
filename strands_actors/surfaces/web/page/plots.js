import {uPlot} from "/page/vendor.js"
import {el} from "/page/dom.js"

const WINDOW_S = 60
const COLOURS = {measured: "#0ea5a4", commanded: "#3b82f6", age: "#d97706"}

/** Plots of one joint: measured and commanded, and the age of the positions, for the last minute. */
export class Plots {
  constructor() {
    this.root = el("div", {class: "plots"})
    this.history = []
    this.joint = ""
    this.sizes = new ResizeObserver(() => this.resize())
    this.sizes.observe(this.root)
  }

  select(joint, unit) {
    if (joint === this.joint) return
    this.joint = joint
    this.values?.destroy()
    this.ages?.destroy()
    const ink = getComputedStyle(document.body).color
    const axis = label => ({label, stroke: ink, grid: {stroke: "#8884", width: 1}, ticks: {stroke: "#8884"}, size: 56})
    const time = {stroke: ink, grid: {stroke: "#8884", width: 1}, values: (plot, ticks) => ticks.map(tick => `${tick} s`)}
    const options = (height, series, label) => ({
      width: this.width(), height, series: [{}, ...series], axes: [time, axis(label)], scales: {x: {time: false}},
      legend: {live: false}, cursor: {show: false},
    })
    const line = name => ({label: name, stroke: COLOURS[name], width: 1.6})
    this.values = new uPlot(
      options(190, [line("measured"), {...line("commanded"), dash: [5, 4]}], `${joint} (${unit})`), [[], [], []], this.root)
    this.ages = new uPlot(options(120, [line("age")], "age (ms)"), [[], []], this.root)
    this.draw()
  }

  add(reading) {
    this.history.push(reading)
    while (this.history.length && reading.t - this.history[0].t > WINDOW_S) this.history.shift()
    this.draw()
  }

  draw() {
    if (!this.values || document.hidden) return
    const last = this.history.at(-1)?.t ?? 0
    const times = this.history.map(reading => reading.t - last)
    const joints = this.history.map(reading => reading.joints.find(joint => joint.name === this.joint))
    this.values.setData([times, joints.map(joint => joint?.measured), joints.map(joint => joint?.commanded)])
    this.ages.setData([times, this.history.map(reading => (reading.age_s < 0 ? null : reading.age_s * 1000))])
  }

  width() { return Math.max(240, this.root.clientWidth) }

  resize() {
    for (const plot of [this.values, this.ages]) plot?.setSize({width: this.width(), height: plot.height})
  }

  close() { this.sizes.disconnect() }
}
