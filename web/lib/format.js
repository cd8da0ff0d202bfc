// Numbers, times and words as texts. No DOM.

/** Shown for what is not known. */
export const NONE = '–'

// Made once: a formatter costs a hundred times what it does.
const COUNTS = new Intl.NumberFormat('en-US')
const TIMES = new Intl.DateTimeFormat('en-GB', { hour: '2-digit', minute: '2-digit', second: '2-digit' })
const DAYS = new Intl.DateTimeFormat('en-GB', { day: 'numeric', month: 'short' })

/** 12,481 */
export const count = n => n == null ? NONE : COUNTS.format(n)

/** 9 of 264. */
export const countOf = (n, of) => `${count(n)} of ${count(of)}`

/** The same, followed by spaces as wide as the digits and commas that it has not yet: its width does not change. */
export const steadyCountOf = (n, of) => {
  const [now, whole] = [count(n), count(of)]
  const rest = whole.slice(0, Math.max(0, whole.length - now.length))
  return countOf(n, of) + rest.replace(/\d/g, '\u2007').replace(/,/g, '\u2008')
}

/** A number with fixed digits and its unit; a true minus sign. */
export const fixed = (x, digits, unit = '') => x == null || Number.isNaN(x) ? NONE
  : x.toFixed(digits).replace(/^-(?=.*[1-9])/, '\u2212').replace('-', '') + (unit && `\u202f${unit}`)

/** A number with three significant digits. */
export const about = (x, unit = '') => {
  if (x == null || Number.isNaN(x)) return NONE
  const size = Math.abs(x), digits = size >= 100 || size === 0 ? 0 : size >= 10 ? 1 : size >= 1 ? 2 : Math.min(6, 2 - Math.floor(Math.log10(size)))
  return fixed(x, digits, unit)
}

/** 1.2 GB */
export function bytes(n) {
  if (n == null) return NONE
  const step = Math.min(4, n < 1 ? 0 : Math.floor(Math.log10(n) / 3))
  const value = n / 1000 ** step
  return `${step && value < 100 ? value.toFixed(1) : Math.round(value)}\u202f${['B', 'kB', 'MB', 'GB', 'TB'][step]}`
}

/** 14:03:59 */
export const clock = t => TIMES.format(new Date(t))

/** 24 Nov */
export const day = t => DAYS.format(new Date(t))

/** 14:03, with the day if it is not today. */
export function moment(t, seconds = false) {
  if (t == null) return NONE
  const midnight = x => new Date(x).setHours(0, 0, 0, 0)
  const days = Math.round((midnight(t) - midnight(Date.now())) / 864e5)
  const words = days === 0 ? '' : days === 1 ? 'tomorrow ' : days === -1 ? 'yesterday '
    : `${day(t)} `
  return words + clock(t).slice(0, seconds ? 8 : 5)
}

/** tomorrow 05:20 (04:44 to 05:56): a moment with its band; a day is said again only if it is another one. */
export function momentBand(likely, low, high, seconds = false) {
  const [end, ...ends] = [likely, low, high].map(t => moment(t, seconds))
  if (ends[0] === ends[1]) return end
  const day = end.slice(0, end.lastIndexOf(' ') + 1)
  return `${end} (${ends.map(text => (text.lastIndexOf(' ') + 1 === day.length && text.startsWith(day) ? text.slice(day.length) : text)).join(' to ')})`
}

/** 95 s, 12 min, 3 h 04 min, 2 days 23 h */
export function span(s) {
  if (s == null) return NONE
  if (s < 10) return `${s.toFixed(1)}\u202fs`
  if (s < 120) return `${Math.round(s)}\u202fs`
  if (s < 3600) return `${Math.floor(s / 60)}\u202fmin`
  if (s < 172_800) return `${Math.floor(s / 3600)}\u202fh ${String(Math.floor(s % 3600 / 60)).padStart(2, '0')}\u202fmin`
  return `${Math.floor(s / 86_400)} days ${Math.floor(s % 86_400 / 3600)}\u202fh`
}

/** Age of a moment, s. */
export const age = t => t == null ? null : Math.max(0, (Date.now() - new Date(t)) / 1e3)

/** 37.8 % of a whole, rounded down: 100 % is said only at the end. */
export const percent = (n, of) => n == null || !of ? NONE : `${(Math.floor(n / of * 1000) / 10).toFixed(1)}\u202f%`

/** tip_change -> tip change */
export const plain = x => typeof x === 'string' ? x.replaceAll('_', ' ') : JSON.stringify(x)

/** First letter in capitals. */
export const capital = text => text && text[0].toUpperCase() + text.slice(1)

/** The parts that there are, as one text. */
export const listed = (parts, between = ', ') => parts.filter(Boolean).join(between)

/** 1 trial, 2 trials */
export const counted = (n, word, words = `${word}s`) => `${count(n)} ${n === 1 ? word : words}`
