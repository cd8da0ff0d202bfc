// Experiment files from this computer: chosen, or dropped anywhere on a page.

const FILE_MAX_BYTES = 1_000_000
const FILES_MOST = 2

/**
 * Reads chosen files: { text, file, sensor? }. An experiment has [real_hex] or [real_random], the other file is
 * its sensor. Throws an error with words for a person.
 */
export async function readExperiment(list) {
  const texts = []
  for (const file of [...list].slice(0, FILES_MOST)) {
    if (file.size > FILE_MAX_BYTES) throw new Error(`${file.name} has more than 1 MB: it is not an experiment file.`)
    texts.push({ name: file.name, text: await file.text() })
  }
  const experiment = texts.find(({ text }) => /^\s*\[real_(hex|random)\]/m.test(text))
  const names = texts.map(one => one.name).join(', ')
  if (!experiment) throw new Error(`${names}: not an experiment file, it has neither [real_hex] nor [real_random].`)
  return { text: experiment.text, file: experiment.name, sensor: texts.find(one => one !== experiment)?.text }
}

/** Takes files that are dropped on the page; `root` is marked while they are above it. Ends with `signal`. */
export function takeDrops(root, take, signal) {
  const isFile = event => event.dataTransfer?.types.includes('Files')
  const mark = on => (root.dataset.drop = on ? 'yes' : '')
  const on = (kind, then) => document.addEventListener(kind, event => isFile(event) && then(event), { signal })
  on('dragover', event => {
    event.preventDefault()
    mark(true)
  })
  on('dragleave', event => event.relatedTarget || mark(false))
  on('drop', event => {
    event.preventDefault()
    mark(false)
    take(event.dataTransfer.files)
  })
}
