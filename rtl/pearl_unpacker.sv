// SPDX-License-Identifier: MIT
// Cuts a stream of words into rows of bits: the inverse of pearl_packer. It costs more, since words come
// to offsets anywhere in a row.
module pearl_unpacker
  import pearl_pkg::*;
#(
    parameter int unsigned ROW_BITS = 48,
    parameter int unsigned DATA_WL  = 32
) (
    input  logic                clk_i,
    input  logic                rst_ni,
    input  logic                valid_i,
    output logic                ready_o,
    input  logic [ DATA_WL-1:0] word_i,
    // No more words come: what is left is the last row, and what is missing of it is padding.
    input  logic                end_i,
    output logic                valid_o,
    input  logic                ready_i,
    output logic [ROW_BITS-1:0] row_o
);

  localparam int unsigned UNIT = common_unit(ROW_BITS, DATA_WL);
  localparam int unsigned ROW_UNITS = ROW_BITS / UNIT;
  localparam int unsigned WORD_UNITS = DATA_WL / UNIT;
  // What is short of a row, and a word.
  localparam int unsigned ACC_UNITS = ROW_UNITS + WORD_UNITS - 1;
  localparam int unsigned ACC_BITS = ACC_UNITS * UNIT;
  localparam int unsigned FILL_BITS = $clog2(ACC_UNITS + 1);
  localparam int unsigned OFFSET_BITS = index_bits(ROW_UNITS);
  // How the fill changes, by whether a row goes out and whether a word comes in.
  localparam int CHANGE[4] = '{0, int'(WORD_UNITS), -int'(ROW_UNITS), int'(WORD_UNITS) - int'(ROW_UNITS)};

  // Whether there is a row, and whether less than one is left once it has gone out: known a cycle before
  // they are needed, as they decide whether the memory is read.
  logic row_q, short_q, take, accept;
  logic [1:0] change;
  logic [3:0] rows, shorts;
  logic [FILL_BITS-1:0] fill_q;
  logic [OFFSET_BITS-1:0] left_q, offset;
  logic [ACC_BITS-1:0] acc_q, kept;

  assign valid_o = row_q || end_i;
  assign row_o   = acc_q[ROW_BITS-1:0];
  assign take    = valid_o && ready_i;
  assign ready_o = take ? short_q : !row_q;
  assign accept  = valid_i && ready_o;
  assign change  = {take, accept};
  // A word only comes where less than a row is left. Said to synthesis, which does not know.
  assign offset  = ROW_UNITS == 1 ? '0 : take ? left_q : fill_q[OFFSET_BITS-1:0];
  assign kept    = take ? acc_q >> ROW_BITS : acc_q;

  // Compared for each change before it is known which one it is.
  for (genvar i = 0; i < 4; i++) begin : gen_change
    assign rows[i]   = int'(fill_q) >= int'(ROW_UNITS) - CHANGE[i];
    assign shorts[i] = int'(fill_q) < 2 * int'(ROW_UNITS) - CHANGE[i];
  end

  always_ff @(posedge clk_i) begin
    if (!rst_ni) begin
      row_q   <= 1'b0;
      short_q <= 1'b1;
      fill_q  <= '0;
      left_q  <= OFFSET_BITS'(-int'(ROW_UNITS));
      acc_q   <= '0;
    end else begin
      row_q   <= rows[change];
      short_q <= shorts[change];
      fill_q  <= fill_q + FILL_BITS'(CHANGE[change]);
      left_q  <= OFFSET_BITS'(fill_q) + OFFSET_BITS'(CHANGE[change] - int'(ROW_UNITS));
      acc_q   <= accept ? kept | (ACC_BITS'(word_i) << (32'(offset) * UNIT)) : kept;
    end
  end

endmodule
