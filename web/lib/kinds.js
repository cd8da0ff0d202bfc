// The kind of an active run, which the status does not carry: asked once for each run.

import { get } from './api.js'

const kinds = new Map()

/** Kind of a run; undefined until the service has answered, so that the next status finds it. */
export function kindOf(uid) {
  if (!kinds.has(uid)) {
    kinds.set(uid, undefined)
    get(`/runs/${uid}`).then(({ kind }) => kinds.set(uid, kind), () => setTimeout(() => kinds.delete(uid), 2000))
  }
  return kinds.get(uid)
}
