// The colours of a picture with their numbers: a bar from nothing to full.

import { dark, el } from './dom.js'
import { paintStrip, sequential, strip } from './frame.js'

/** Makes a scale; `ticks(texts)` writes the numbers below it, from its low end to its high end. */
export function scaleBar(words, signal) {
  const bar = strip(i => [i, i, i], 'colours'), marks = el('div', { className: 'ticks' })
  const paint = () => {
    const palette = sequential()
    paintStrip(bar, i => palette[i])
  }
  dark.addEventListener('change', paint, { signal })
  paint()
  return { node: el('div', { className: 'scale' }, el('span', {}, words), bar, marks),
    ticks: texts => marks.replaceChildren(...texts.map(text => el('span', {}, text))) }
}
