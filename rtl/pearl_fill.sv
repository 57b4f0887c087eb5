// SPDX-License-Identifier: MIT
// How full a packer is, in units of UNIT bits: a row comes in, a word goes out whenever there is one.
//
// The packer uses it to place rows. The group reader uses another one to know, a fixed latency
// ahead, whether the packer will have room: so nothing between the two ever has to stall.
//
// A row waits until less than a word is left of those before it, so that a packer has to place rows at
// offsets within a word only. No word of this packer is later for it, as the one that has to go out
// first is there already. One of another packer may be, if both have rows of more than a word: the
// group reader waits for all of them.
module pearl_fill
  import pearl_pkg::*;
#(
    // Bits of a row and of a word in units of their common power of two.
    parameter  int unsigned ROW_UNITS   = 3,
    parameter  int unsigned WORD_UNITS  = 2,
    localparam int unsigned OFFSET_BITS = index_bits(WORD_UNITS)
) (
    input  logic                   clk_i,
    input  logic                   rst_ni,
    input  logic                   clear_i,
    input  logic                   row_i,
    output logic                   word_o,
    // Where a row that comes in this cycle is put, after this cycle's word has gone out.
    output logic [OFFSET_BITS-1:0] offset_o,
    // Whether there is room for it.
    output logic                   ready_o
);

  localparam int unsigned FILL_BITS = $clog2(ROW_UNITS + WORD_UNITS);

  // How the fill changes, by whether a row comes in and whether a word goes out.
  localparam int CHANGE[4] = '{0, -int'(WORD_UNITS), int'(ROW_UNITS), int'(ROW_UNITS) - int'(WORD_UNITS)};

  logic [1:0] change;
  logic [3:0] words, rooms;
  logic word_q, room_q;
  logic [FILL_BITS-1:0] fill_q, left;

  assign change   = {row_i, word_q};
  assign word_o   = word_q;
  assign left     = word_q ? fill_q - FILL_BITS'(WORD_UNITS) : fill_q;
  assign ready_o  = room_q;
  // Said to synthesis, which does not know that no row comes at another one.
  assign offset_o = WORD_UNITS == 1 ? '0 : left[OFFSET_BITS-1:0];

  // Compared for each change before it is known whether a row comes: groups are issued by what comes out.
  for (genvar i = 0; i < 4; i++) begin : gen_change
    assign words[i] = int'(fill_q) >= int'(WORD_UNITS) - CHANGE[i];
    assign rooms[i] = int'(fill_q) < 2 * int'(WORD_UNITS) - CHANGE[i];
  end

  always_ff @(posedge clk_i) begin
    if (!rst_ni || clear_i) begin
      word_q <= 1'b0;
      room_q <= 1'b1;
      fill_q <= '0;
    end else begin
      word_q <= words[change];
      room_q <= rooms[change];
      fill_q <= row_i ? left + FILL_BITS'(ROW_UNITS) : left;
    end
  end

endmodule
