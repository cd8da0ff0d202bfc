// The names that the API uses, with what they mean, and what the paper prints: read once, before the first page is shown.

import { get, readOnce } from './api.js'

/** Body of `GET /vocabulary`: methods, scored, slots, tasks, formats, maps, flags, events, trips, pauses, phases, rig_states, roles, limits of a simulation. */
export const vocabulary = {}
/** Body of `GET /published`. */
export const paper = {}

/** Reads both, once; `vocabulary` and `paper` have them afterwards. */
export const readVocabulary = readOnce(async () => {
  const [names, printed] = await Promise.all([get('/vocabulary'), get('/published')])
  Object.assign(vocabulary, names)
  Object.assign(paper, printed)
})

/** What a name of a list means; '' for one that the service does not list. */
export const meaning = (list, name) => vocabulary[list].find(one => one.name === name)?.about ?? ''
