// The printed overlay of the points at true scale: what it is for, and its files.

import { outcome } from './actions.js'
import { ask, withQuery } from './api.js'
import { button, download, el } from './dom.js'

const PAPERS = [['a4', 'On A4 pages', 'tiles with crop marks, to be joined'], ['sheet', 'On one sheet', 'for a plotter']]

/** Makes the buttons that fetch the overlay (with the key, which no address may hold) and save it; what came of it is below them. */
export function overlay() {
  const said = outcome()
  const fetched = paper => said.run('Overlay', async () => {
    const response = await ask(withQuery('/api/v1/sensor/overlay.pdf', { paper }), { accept: 'application/pdf', wait: 60_000 })
    download(`overlay-${paper}.pdf`, await response.blob())
  })
  return el('div', {}, el('div', { className: 'row' }, PAPERS.map(([paper, words, title]) => button(words, () => fetched(paper), { title }))), said.node)
}
