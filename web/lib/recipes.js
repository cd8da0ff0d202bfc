// The recipes that the program carries, from which the form of a training starts.

import { get } from './api.js'

let asked = null

/** Recipes with their texts, and the keys that follow from each force map; asked for once. */
export function recipes() {
  asked ??= get('/recipes').then(page => page.items)
  asked.catch(() => {
    asked = null
  })
  return asked
}
