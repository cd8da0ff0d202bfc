// Facts that change many times: only texts that differ are set, so that nothing jumps and a reader hears nothing twice.

import { facts, fill, say } from './dom.js'

/** Shows facts ([name, text] each, false ones are omitted) in `node`. */
export function changing(node, rows) {
  const wanted = rows.filter(Boolean), names = wanted.map(([name]) => name).join()
  if (node.dataset.names !== names) {
    node.dataset.names = names
    fill(node, facts(wanted))
  }
  const cells = node.querySelectorAll('dd')
  wanted.forEach(([, value], i) => say(cells[i], value))
}
