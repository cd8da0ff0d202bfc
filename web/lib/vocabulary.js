// The names that the API uses, with what they mean, and what the paper prints: read once, before the first page is shown.

import { get } from './api.js'

/** Body of `GET /vocabulary`: methods, scored, slots, tasks, formats, maps, flags, events, trips, pauses, roles, limits of a simulation. */
export const vocabulary = {}
/** Body of `GET /published`. */
export const paper = {}

let asked = null

/** Reads both, once; `vocabulary` and `paper` have them afterwards. */
export function readVocabulary() {
  asked ??= Promise.all([get('/vocabulary'), get('/published')]).then(([names, printed]) => {
    Object.assign(vocabulary, names)
    Object.assign(paper, printed)
  })
  asked.catch(() => {
    asked = null
  })
  return asked
}

/** What a name of a list means; '' for one that the service does not list. */
export const meaning = (list, name) => vocabulary[list].find(one => one.name === name)?.about ?? ''
