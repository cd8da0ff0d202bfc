// Rows of a table moved by dragging; a line shows where the row will be. Buttons must do the same.

import { named } from './actions.js'
import { live } from './live.js'

const KIND = 'application/x-palpate-row'

/** Lets the rows of a table in `node` be dragged. `rows()` are its things, `move(thing, position)` moves one, position from 1. */
export function dragRows(node, { rows, move }) {
  let dragged = null
  const lines = () => [...node.querySelectorAll('tbody tr')]
  const isRow = event => event.dataTransfer.types.includes(KIND)
  const mark = (tr, where) => lines().forEach(one => (one.dataset.drop = one === tr ? where : ''))

  async function drop(event, tr, at) {
    if (!isRow(event)) return
    event.preventDefault()
    const thing = dragged
    const from = rows().indexOf(thing) // None if the rows were read again meanwhile, or are those of another window.
    const to = at + (tr.dataset.drop === 'below' ? 1 : 0)
    mark(null)
    if (from < 0 || to === from || to === from + 1 || !(await named())) return
    move(thing, to > from ? to : to + 1)
  }

  /** Called whenever the rows were drawn. */
  function attach() {
    lines().forEach((tr, at) => {
      tr.draggable = live.may('operator') && rows().length > 1
      tr.ondragstart = event => {
        dragged = rows()[at]
        event.dataTransfer.setData(KIND, String(at))
        event.dataTransfer.effectAllowed = 'move'
      }
      tr.ondragover = event => {
        if (!isRow(event)) return
        event.preventDefault()
        const { top, height } = tr.getBoundingClientRect()
        mark(tr, event.clientY > top + height / 2 ? 'below' : 'above')
      }
      tr.ondrop = event => drop(event, tr, at)
      tr.ondragend = () => {
        dragged = null
        mark(null)
      }
    })
  }
  return { attach }
}
