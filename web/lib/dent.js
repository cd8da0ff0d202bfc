// The compression of the foam over the skin as a picture, with its colours and their scale.

import { dark, el, soon } from './dom.js'
import { fixed } from './format.js'
import { roundUp, sequential } from './frame.js'
import { scaleBar } from './scalebar.js'

/** Makes a grid that can be drawn on a skin: `take(grid)`, `draw(pen, view)`, `legend` (a node). */
export function dent(signal) {
  const image = el('canvas'), scale = scaleBar('compression of the foam', signal)
  let grid = null, end = 1
  const paint = () => {
    const colours = sequential()
    scale.ticks([0, 0.25, 0.5, 0.75, 1].map(t => t === 1 ? fixed(end, end < 1 ? 2 : 1, 'mm') : fixed(t * end, 2)))
    if (!grid) return
    const { columns, rows, values } = grid, to = new ImageData(columns, rows)
    values.forEach((mm, i) => {
      const t = Math.min(1, mm / end), row = rows - 1 - Math.floor(i / columns)
      // The first few colours are the ground: they fade in, so that points and electrodes stay visible.
      to.data.set([...colours[Math.round(254 * t)], Math.min(255, 2200 * t)], 4 * (row * columns + i % columns))
    })
    Object.assign(image, { width: columns, height: rows })
    image.getContext('2d').putImageData(to, 0, 0)
  }
  dark.addEventListener('change', soon(paint), { signal })
  paint()
  return {
    legend: scale.node,
    take(next) {
      grid = next
      const most = next ? next.values.reduce((a, b) => Math.max(a, b), 0) : 0
      // The scale grows and shrinks in steps, so that two glances can be compared.
      if (most > end || most < 0.2 * end) end = roundUp(Math.max(most, 0.1))
      paint()
    },
    draw(pen, view) {
      if (!grid) return
      const { columns, rows, pitch_mm: pitch, x0_mm: x0, y0_mm: y0 } = grid
      pen.imageSmoothingEnabled = true
      pen.drawImage(image, view.x(x0 - pitch / 2), view.y(y0 + (rows - 0.5) * pitch), columns * pitch * view.scale, rows * pitch * view.scale)
    },
  }
}
