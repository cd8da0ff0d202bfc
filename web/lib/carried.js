// The experiments that the program carries: the list that the queue and the plan offer.

import { get, readOnce } from './api.js'
import { el, link } from './dom.js'
import { count } from './format.js'
import { table } from './table.js'

/** Experiments that the program carries; asked for once. */
export const carried = readOnce(() => get('/experiments').then(page => page.items))

/** One of them by its name. */
export async function carriedItem(name) {
  const found = (await carried()).find(item => item.name === name)
  if (!found) throw new Error(`the program carries no experiment ${name}`)
  return found
}

/** A table of them; `href(item)` is where a choice leads. */
export async function carriedTable(href) {
  try {
    const { node } = table({
      rows: await carried(),
      caption: 'Experiments that the program carries',
      empty: 'This program carries no experiments.',
      columns: [
        { head: 'Name', left: true, cell: item => link(href(item), item.name) },
        { head: 'Trials', cell: item => count(item.trials) },
        { head: 'What it does', left: true, cell: item => item.about },
      ],
    })
    node.classList.add('stack', 'carried')
    return node
  } catch (error) {
    return el('p', { className: 'soft' }, `The list of carried experiments could not be read: ${error.message}. Choose a file instead.`)
  }
}
