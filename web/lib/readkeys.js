// The keys by which pictures are read, as the list of keys shows them.

/** Keys of charts, box plots, frames and maps: title and rows of [keys, what they do]. */
export const READ_KEYS = [
  ['On a chart', [
    ['Left, Right', 'point by point'],
    ['Page Up, Page Down', 'a tenth of the points'],
    ['Home, End', 'first and last point'],
    ['Plus, Minus', 'zoom in and out at the point'],
    ['Escape', 'the whole chart'],
    ['1 to 9', 'hide or show a curve'],
    ['Enter', 'open the nearest event, where there are events'],
  ]],
  ['On a box plot', [['Left, Right', 'box by box'], ['Home, End', 'first and last box']]],
  ['On a frame', [
    ['Arrows', 'cell by cell'],
    ['Home, End', 'first and last cell of the row'],
    ['Page Up, Page Down', 'first and last row'],
  ]],
  ['On a skin', [
    ['Arrows', 'to the next place in this direction; 10 mm where there are no places, 1 mm with Shift'],
    ['Home, End', 'first and last place'],
    ['Page Up, Page Down', 'place by place, or step by step of a tour'],
    ['Enter', 'choose, or press the skin there'],
  ]],
]

/** The keys of one kind of picture as a sentence. */
export const keysOf = title => READ_KEYS.find(([words]) => words === title)[1].map(([keys, words]) => `${keys}: ${words}`).join('; ')
