// Facts that change many times: only texts that differ are set, so that nothing jumps and a reader hears nothing twice.

import { facts, renew, say } from './dom.js'

/** Shows facts ([name, text] each, false ones are omitted) in `node`. */
export function changing(node, rows) {
  const wanted = rows.filter(Boolean)
  renew(node, wanted.map(([name]) => name), () => facts(wanted))
  const cells = node.querySelectorAll('dd')
  wanted.forEach(([, value], i) => say(cells[i], value))
}
