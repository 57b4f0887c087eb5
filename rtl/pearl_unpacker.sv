// Reads the words of a memory from the first to the last and cuts the stream into rows of bits: the
// inverse of pearl_packer. It costs more, since words come to offsets anywhere in a row.
module pearl_unpacker
  import pearl_pkg::*;
#(
    parameter int unsigned ROW_BITS = 48,
    parameter int unsigned DATA_WL = 32,
    parameter int unsigned WORDS = 3,
    localparam int unsigned ADDR_BITS = index_bits(WORDS)
) (
    input  logic                 clk_i,
    input  logic                 rst_ni,
    // Starts over at the first word.
    input  logic                 start_i,
    output logic                 re_o,
    output logic [ADDR_BITS-1:0] raddr_o,
    // Valid in the cycle after re_o.
    input  logic [  DATA_WL-1:0] rdata_i,
    output logic                 valid_o,
    output logic [ ROW_BITS-1:0] row_o,
    input  logic                 take_i
);

  localparam int unsigned UNIT = common_unit(ROW_BITS, DATA_WL);
  localparam int unsigned ROW_UNITS = ROW_BITS / UNIT;
  localparam int unsigned WORD_UNITS = DATA_WL / UNIT;
  // Where rows and words end together, one word beyond a row keeps a word a cycle coming; where they
  // do not, it takes two.
  localparam bit ALIGNED = ROW_BITS % DATA_WL == 0 || DATA_WL % ROW_BITS == 0;
  localparam int unsigned ACC_UNITS = ROW_UNITS + (ALIGNED ? 1 : 2) * WORD_UNITS;
  localparam int unsigned ACC_BITS = ACC_UNITS * UNIT;
  localparam int unsigned FILL_BITS = $clog2(ACC_UNITS + 1);

  logic active_q, arriving_q, exhausted;
  logic [FILL_BITS-1:0] fill_q, offset, filled;
  logic [ACC_BITS-1:0] acc_q, kept;
  logic [$clog2(WORDS+1)-1:0] count_q;

  assign exhausted = 32'(count_q) == WORDS && !arriving_q;
  // The stream may end within the last row, whose missing slots are padding.
  assign valid_o = active_q && (32'(fill_q) >= ROW_UNITS || exhausted);
  assign row_o = acc_q[ROW_BITS-1:0];
  assign kept = take_i ? acc_q >> ROW_BITS : acc_q;
  assign offset = take_i ? fill_q - FILL_BITS'(ROW_UNITS) : fill_q;
  assign filled = arriving_q ? offset + FILL_BITS'(WORD_UNITS) : offset;
  assign re_o = active_q && 32'(count_q) != WORDS && 32'(filled) + WORD_UNITS <= ACC_UNITS;
  assign raddr_o = count_q[ADDR_BITS-1:0];

  always_ff @(posedge clk_i) begin
    if (start_i) acc_q <= '0;
    else if (arriving_q) acc_q <= kept | (ACC_BITS'(rdata_i) << (32'(offset) * UNIT));
    else acc_q <= kept;
  end

  always_ff @(posedge clk_i or negedge rst_ni) begin
    if (!rst_ni) begin
      active_q   <= 1'b0;
      arriving_q <= 1'b0;
      fill_q     <= '0;
      count_q    <= '0;
    end else if (start_i) begin
      active_q   <= 1'b1;
      arriving_q <= 1'b0;
      fill_q     <= '0;
      count_q    <= '0;
    end else begin
      arriving_q <= re_o;
      fill_q     <= filled;
      if (re_o) count_q <= count_q + 1'b1;
    end
  end

endmodule
