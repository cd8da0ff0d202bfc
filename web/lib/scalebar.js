// The colours of a picture with their numbers: a bar from nothing to full.

import { dark, el } from './dom.js'
import { sequential } from './frame.js'

/** Makes a scale; `ticks(texts)` writes the numbers below it, from its low end to its high end. */
export function scaleBar(words, signal) {
  const bar = el('canvas', { width: 255, height: 1, className: 'colours', 'aria-hidden': 'true' }), marks = el('div', { className: 'ticks' })
  const paint = () => {
    const pixels = new ImageData(255, 1)
    sequential().forEach((rgb, i) => pixels.data.set([...rgb, 255], 4 * i))
    bar.getContext('2d').putImageData(pixels, 0, 0)
  }
  dark.addEventListener('change', paint, { signal })
  paint()
  return { node: el('div', { className: 'scale' }, el('span', {}, words), bar, marks),
    ticks: texts => marks.replaceChildren(...texts.map(text => el('span', {}, text))) }
}
